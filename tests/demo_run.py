"""The demo, run once for all tests of a process that look at it."""

import functools
from pathlib import Path
from tempfile import mkdtemp

import pytest

from aerobalance.app.demos.demo import run_demo
from aerobalance.recording.errors import DataQualityWarning
from seeds import new_seed, running


@functools.cache
def demo_once() -> tuple[Path, dict]:
    """Folder of the demo and its account."""
    folder = Path(mkdtemp(prefix="aerobalance-demo-"))
    with running("the demo"):  # whichever test comes first
        seed = new_seed()
    with pytest.warns(DataQualityWarning, match="not steady"):  # the unsteady record is there to be doubted
        account = run_demo(folder, seed=seed)
    return folder, account
