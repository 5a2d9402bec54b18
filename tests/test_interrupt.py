"""Ctrl-C and SIGTERM at any moment: one line, exit 130 or 143, old outputs kept, nothing half-written."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from seeds import trials

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals are those of POSIX")
IMPORT = "import time:"
FIRST = "aerobalance.app.cli.interrupt"
WAIT = 60.0


@pytest.fixture(autouse=True)
def hears_ctrl_c():
    """Let children hear Ctrl-C even where the tests run in the background of a shell, which has it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    folder = tmp_path_factory.mktemp("interrupted")
    load = np.random.default_rng(3).normal(size=4000)
    rows = [f"{number / 1000:.4g},{value:.6g}" for number, value in enumerate(load)]
    (folder / "run.csv").write_text("\n".join(["time [s],AF [N]", *rows]) + "\n")
    return folder


def ended_at(folder, words, place, number=signal.SIGINT):
    """Run a command whose imports are told as they happen, and send a signal at the one of this place.

    The places are counted from where the program has settled what Ctrl-C does; None sends nothing.

    Returns
    -------
    Exit code, what was said on standard error, and how many imports there were.
    """
    command = [sys.executable, "-X", "importtime", "-m", "aerobalance.app.cli", *words]
    said, count, begun = [], 0, False
    environment = os.environ | {"PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=environment
    ) as running:
        for line in running.stderr:
            if not line.startswith(IMPORT):
                said.append(line.rstrip("\n"))
                continue
            begun = begun or line.rstrip().endswith(FIRST)
            count += begun
            if place is not None and count == place + 2:  # one more, so that the handler is there
                running.send_signal(number)
                place = None
        running.wait(timeout=WAIT)
    return running.returncode, said, count


def left(folder):
    return sorted(path.name for path in folder.iterdir())


def test_interrupt_while_the_program_loads_or_works(here):
    words = ["convert", "run.csv", "-o", "out.csv", "--replace"]
    code, said, total = ended_at(here, words, None)
    assert (code, said) == (0, [])
    complete = (here / "out.csv").read_bytes()
    files = left(here)
    codes, instants = [], trials(3, 20)
    for place in np.linspace(0, total - 3, instants).round().astype(int):
        (here / "out.csv").write_text("old")
        code, said, _ = ended_at(here, words, place)
        codes.append(code)
        now = (here / "out.csv").read_bytes()
        assert left(here) == files, place
        if code == 130:
            written = now == complete
            assert said == ["interrupted; out.csv was written" if written else "interrupted; nothing was written"]
            assert written or now == b"old", place
        else:  # the result was there before the signal was
            assert (code, said, now) == (0, [], complete), place
    assert codes.count(130) >= instants // 2, codes
    assert codes[0] == 130


def test_sigterm_while_the_program_loads(here):
    code, said, _ = ended_at(here, ["info", "run.csv"], 40, signal.SIGTERM)
    assert (code, said) == (143, ["told to end (SIGTERM); nothing was written"])


HALF_WRITTEN = """
import sys, time
from aerobalance.app.cli import interrupt
from aerobalance.io.safe_write import OUTPUTS, replacing
from pathlib import Path
interrupt.watch()
OUTPUTS.begin(replace=True)
OUTPUTS.wanted += [Path("first.csv"), Path("second.html")]
for name in sys.argv[1:]:
    with replacing(name) as beside:
        beside.write_text("new")
with replacing("second.html") as beside:
    beside.write_text("half of it")
    print("writing", flush=True)
    while True:
        try:
            time.sleep(1)  # a signal just before it begins is heard after it
        except BaseException:
            pass  # as libraries do that catch everything
"""


@pytest.mark.parametrize(
    ("before", "says"),
    [((), "nothing was written"), (("first.csv",), "first.csv was written, second.html was not")],
)
def test_interrupt_while_a_file_is_written(tmp_path, before, says):
    (tmp_path / "second.html").write_text("old")
    command = [sys.executable, "-c", HALF_WRITTEN, *before]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        assert running.stdout.readline() == "writing\n"
        running.send_signal(signal.SIGINT)
        _, err = running.communicate(timeout=WAIT)
    assert (running.returncode, err) == (130, f"interrupted; {says}\n")
    assert left(tmp_path) == sorted([*before, "second.html"])
    assert Path(tmp_path / "second.html").read_text() == "old"
