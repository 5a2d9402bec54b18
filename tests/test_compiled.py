"""Loops that are compiled once for a machine: what is kept of another version does no harm, and the pause is told."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

import aerobalance
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.recording.compiled import SOURCES, STATE, state_of
from aerobalance.simulation.published import CABLE_CUT

ROOT = Path(aerobalance.__file__).parent


def test_all_that_is_compiled_is_in_the_digest():
    files = {
        path.relative_to(ROOT).as_posix()
        for path in ROOT.rglob("*.py")
        if re.search(r"import numba|numba\.", path.read_text())
    }
    users = {path.relative_to(ROOT).as_posix() for path in ROOT.rglob("*.py") if "@compiled(" in path.read_text()}
    assert files <= set(SOURCES)
    assert users | {"recording/compiled.py"} == set(SOURCES)
    assert state_of(ROOT) == STATE


def test_a_change_of_any_source_makes_another_digest(tmp_path):
    for name in SOURCES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    assert state_of(tmp_path) == STATE
    for name in SOURCES:
        before = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(before + b"#\n")
        assert state_of(tmp_path) != STATE, name
        (tmp_path / name).write_bytes(before)


def test_the_compiler_is_loaded_by_the_first_loop_that_is_called():
    """Looking at a file, recording and the page's server call none."""
    program = (
        "import sys, numpy as np; import aerobalance.app.cli.program, aerobalance.acquisition.recorder; "
        "from aerobalance.dynamics import _kernels; from aerobalance.estimation import force; "
        "before = 'numba' in sys.modules; "
        "print(before, callable(_kernels.first_order))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "False True\n"


TWO_THREADS = """
import threading, time
from aerobalance.recording import compiled as module
made, begun = module._made, threading.Event()
def slow(function, options):
    if "called" in function.__qualname__:
        begun.set()
        time.sleep(0.3)
    return made(function, options)
module._made = slow
@module.compiled()
def called(x):
    return 2 * x
@module.compiled()
def calling(x):
    return called(x) + 1
first = threading.Thread(target=calling, args=(1,))
first.start()
begun.wait()
print(calling(3))
first.join()
"""


def test_two_threads_may_be_the_first_to_call():
    """The second must not compile before what is called is in the compiler's hands too."""
    done = subprocess.run([sys.executable, "-c", TWO_THREADS], capture_output=True, text=True, check=False)
    assert done.stdout == "7\n", done.stderr[-500:]


KERNELS = """
from typing import NamedTuple
import numpy as np
from aerobalance.recording.compiled import compiled
class {model}(NamedTuple):
    values: np.ndarray
@compiled()
def total(model):
    found = 0.0
    for value in model.values:
        found += {weight} * value
    return found
print(total({model}(np.ones(3))))
"""


def test_what_another_version_left_is_not_read_and_taken_away(tmp_path):
    """A class of an argument has another name in the next version, as happens, and the loop another result."""
    package = tmp_path / "aerobalance"
    shutil.copytree(ROOT, package, ignore=shutil.ignore_patterns("__pycache__"))
    kernels = package / "dynamics" / "_kernels.py"
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": ""}
    said, kept = [], []
    for model, weight in (("Model", 1), ("StateSpace", 2), ("StateSpace", 2)):
        kernels.write_text(KERNELS.format(model=model, weight=weight))
        command = [sys.executable, "-c", "import aerobalance.dynamics._kernels"]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        said.append(done.stdout)
        kept.append({file.name: file.stat().st_mtime_ns for file in kernels.parent.glob("__pycache__/*.nb?")})
    assert said == ["3.0\n", "6.0\n", "6.0\n"]
    assert len(kept[0]) == len(kept[1]) == 2 and not set(kept[0]) & set(kept[1])
    assert kept[1] == kept[2]  # compiled once for each version


def test_the_pause_of_the_first_use_is_told_once_on_standard_error(tmp_path):
    readings = np.random.default_rng(1).normal(size=1200)
    rows = [f"{k / 1000:.4g},{value:.6g}" for k, value in enumerate(readings)]
    (tmp_path / "run.csv").write_text("\n".join(["time [s],AF [N]", *rows]) + "\n")
    write_dynamics(tmp_path / "dynamics.json", {"AF": CABLE_CUT.dynamics})
    words = [sys.executable, "-m", "aerobalance.app.cli", "force", "run.csv", "--dynamics", "dynamics.json"]
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    first, second = (
        subprocess.run(
            [*words, "-o", "f.csv", "--replace"],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        for _ in range(2)
    )
    told = re.findall(r"^compiling .* once: this takes a few seconds$", first.stderr, re.MULTILINE)
    assert len(told) == 1
    assert first.stderr.replace(told[0] + "\n", "") == second.stderr
    assert first.stdout.replace("written", "") == second.stdout.replace("replaced", "")


KEPT_AND_NEW = """
import sys
import numpy as np
from aerobalance.recording.compiled import compiled
@compiled()
def added(x):
    found = np.empty(x.size)
    for place in range(x.size):
        found[place] = x[place] + 1.0
    return found
print(added(np.arange(3.0)), "numba.np.npyimpl" in sys.modules)
@compiled()
def twice(x):
    return 2.0 * added(x)[-1]
print(twice(np.arange(3.0)), "numba.np.npyimpl" in sys.modules)
"""


def test_what_is_kept_is_loaded_without_what_the_compiler_compiles_with(tmp_path):
    """That takes longer than all the loops; what is compiled afterwards calls what was loaded."""
    (tmp_path / "loops.py").write_text(KEPT_AND_NEW)

    def said():
        words = [sys.executable, "-c", "import loops"]
        return subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True).stdout.splitlines()

    assert said() == ["[1. 2. 3.] True", "6.0 True"]  # both compiled
    assert said() == ["[1. 2. 3.] False", "6.0 False"]  # both kept
    (kept,) = tmp_path.glob("__pycache__/loops.twice*.nbi")
    kept.unlink()
    assert said() == ["[1. 2. 3.] False", "6.0 True"]
