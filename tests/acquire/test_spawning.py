"""Processes beside a clock compute with one thread, and whoever starts them keeps its own."""

import multiprocessing
import os

import pytest

from aerobalance.acquisition.session import start_on_one_thread

NAME = "OPENBLAS_NUM_THREADS"


def tell(pipe):
    pipe.send(os.environ.get(NAME))


@pytest.mark.parametrize(("given", "found"), [(None, "1"), ("2", "2")])
def test_one_thread_unless_said_otherwise(given, found, monkeypatch) -> None:
    monkeypatch.delenv(NAME, raising=False)
    if given is not None:
        monkeypatch.setenv(NAME, given)
    spawn = multiprocessing.get_context("spawn")
    here, there = spawn.Pipe()
    process = spawn.Process(target=tell, args=(there,))
    start_on_one_thread(process)
    assert here.recv() == found
    process.join(30)
    assert os.environ.get(NAME) == given
