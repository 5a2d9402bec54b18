"""What a command loads before it begins: no more than it needs, and without a search for unused memory meanwhile."""

import subprocess
import sys

SLOW = {
    "matplotlib",
    "pandas",
    "pint",
    "statsmodels",
    "scipy.interpolate",
    "scipy.ndimage",
    "scipy.signal",
    "scipy.stats",
}


def printed(code, *words):
    """What a program prints that is run in a process of its own."""
    done = subprocess.run([sys.executable, "-c", code, *words], check=True, capture_output=True, text=True)
    return done.stdout.split()


def test_force_and_live_processes_load_no_library_that_few_of_them_need():
    modules = (
        "app.commands.force",
        "acquisition.simulated",
        "acquisition.recorder",
        *(f"app.monitor.{n}" for n in ("engine", "learner", "jobs")),
    )
    loaded = printed(f"import sys, {', '.join(f'aerobalance.{name}' for name in modules)}; print(*sys.modules)")
    assert {"scipy.optimize", "scipy.linalg"} <= set(loaded)  # so that libraries are seen
    assert not SLOW & set(loaded)


SEARCHING = """
import gc, sys, time
from aerobalance.app import cli
from aerobalance.app.commands import recordings
print(gc.isenabled(), gc.get_freeze_count() > 0)
def info(*_, **__):
    print(gc.isenabled(), gc.get_freeze_count() > 50_000)
    return {"summary": ""}
recordings.info = info
sys.argv = ["aerobalance", "info", "none.csv"]
try:
    cli.run()
finally:
    print(gc.isenabled())
"""


def test_unused_memory_is_looked_for_while_a_command_works_but_not_in_what_was_loaded():
    words = printed(SEARCHING)
    assert words[:2] == ["True", "False"]  # before
    assert words[2:] == ["True", "True", "True"]  # at work, and at the end
