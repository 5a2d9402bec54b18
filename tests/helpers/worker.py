"""What a worker process is asked in tests."""

import os
from pathlib import Path

import numpy as np


def tell_threads(pipe):
    """Send how many threads a large product of matrices leaves in this process."""
    np.ones((600, 600)) @ np.ones((600, 600))
    pipe.send(len(list(Path("/proc/self/task").iterdir())))


def crash(*, memory):
    """A device whose library ends its process."""
    os.abort()
