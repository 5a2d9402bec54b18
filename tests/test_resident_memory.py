"""The memory that the program gives back: the compiler's code, and nothing that is needed."""

from __future__ import annotations

import subprocess
import sys

import pytest

CODE = """
from pathlib import Path
import numpy as np
from aerobalance.app.resident_memory import give_back_compiler
from aerobalance.estimation.spectra import _kernels

def resident():
    sizes, own = [], False
    for line in Path("/proc/self/smaps").read_text(errors="replace").splitlines():
        first = line.split()[0]
        if "-" in first and not first.endswith(":"):
            own = " r-xp " in line and "libllvmlite" in line
        elif own and first == "Rss:":
            sizes.append(int(line.split()[1]))
    return sum(sizes)

def averages():
    return _kernels.averages(np.linspace(1.0, 3.0, 64), 2, 0.1, 8.0).tolist()

give_back_compiler()  # there is none yet
first = averages()
before = resident()
give_back_compiler()
print(before, resident())
print(first == averages())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="memory is given back on Linux alone")
def test_the_code_of_the_compiler_is_given_back_and_read_again() -> None:
    words = [sys.executable, "-c", CODE]
    found = subprocess.run(words, capture_output=True, text=True, check=True, timeout=300).stdout.split()
    before, after = int(found[0]), int(found[1])
    assert before > 1000  # kB: it loads what was compiled
    assert after < before / 10
    assert found[2] == "True"
