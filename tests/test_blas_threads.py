"""The linear algebra has one thread while the library works, and before and afterwards as many as it had."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from aerobalance.recording.blas_threads import VARIABLES, settings_of_process

OURS = 3
"""Threads that the program of a user has; a library takes more than there are processors, if it is told to."""

START = f"""
import json, sys, threading, warnings
import numpy as np
import scipy.linalg
from threadpoolctl import threadpool_info, threadpool_limits
import aerobalance as ab
from aerobalance.recording.blas_threads import one_blas_thread

def threads():
    return sorted({{one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}})

threadpool_limits({OURS}, user_api="blas")
"""


def told(program: str, **environment: str) -> object:
    """What a program prints as JSON whose environment says nothing of threads but what is given."""
    kept = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    kept["PYTHONPATH"] = os.pathsep.join(sys.path[1:])
    command = [sys.executable, "-c", START + program]
    done = subprocess.run(command, env=kept | environment, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_one_thread_meanwhile_and_as_before_afterwards():
    program = """
found = [threads()]
with one_blas_thread():
    found.append(threads())
    with one_blas_thread():
        found.append(threads())
    found.append(threads())
print(json.dumps([*found, threads()]))
"""
    assert told(program) == [[OURS], [1], [1], [1], [OURS]]


def test_the_last_of_several_threads_gives_back_what_was():
    """The first to come is the first to go: if it gave back what was, the second would work with more."""
    program = """
inside, left, seen = threading.Event(), threading.Event(), []

def second():
    with one_blas_thread():
        inside.set()
        left.wait(60)
        seen.append(threads())

other = threading.Thread(target=second)
with one_blas_thread():
    other.start()
    inside.wait(60)
left.set()
other.join(60)
print(json.dumps([*seen, threads()]))
"""
    assert told(program) == [[1], [OURS]]


def test_who_says_how_many_threads_there_are_is_heard():
    program = """
with one_blas_thread():
    print(json.dumps(threads()))
"""
    assert told(program, OMP_NUM_THREADS="2") == [OURS]
    assert settings_of_process({"OMP_NUM_THREADS": "2"}) == {}
    assert set(settings_of_process({}).values()) == {"1"}


DOORS = """
from aerobalance.simulation import CableCut, Sensor
from aerobalance.simulation.calibration_stand import CalibrationStand
from aerobalance.simulation.six_balance import random_balance

found = {}

def at_work(name, work, *given, **more):
    seen = []

    def look(frame, event, argument):  # the first calls that the library makes of its own files
        file = frame.f_code.co_filename
        if event == "call" and file.startswith(ab.__path__[0]) and "blas_threads" not in file:
            sys.setprofile(None)  # for good after these: it doubles the time of all that follows
            seen.append(threads())
            if len(seen) < 20:
                sys.setprofile(look)

    sys.setprofile(look)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = work(*given, **more)
    finally:
        sys.setprofile(None)
    found[name] = [seen[1:], threads()]  # the first call is that of the function itself
    return result

rng = np.random.default_rng(1)
rig = CableCut(sensors={"AF": Sensor(noise=10.0)})
record = rig.run(1.5, rng).recording
known = at_work("identify", ab.identify, record, mass=rig.dynamics.mass).dynamics
force = at_work("estimate_force", ab.estimate_force, record, known)
at_work("monte_carlo", ab.monte_carlo, force, draws=10)
at_work("budget", ab.budget, force)
at_work("compare", ab.compare, record, known)
at_work("plan", ab.plan, known, rate=1600.0, noise=10.0)
balance = random_balance(rng)
noise = 1e-4 * float(balance.matrix.output_scale.min())
schedule = CalibrationStand(balance.matrix, noise=noise, repeats=3).run(3).schedule
at_work("calibrate", ab.calibrate, schedule, model="linear", reading_noise=noise)
live = ab.LiveForce(known, rate=1600.0)
at_work("push", live.push, {"AF": record.channel("AF").values})
at_work("finish", live.finish)
print(json.dumps(found))
"""


def test_every_public_function_that_works_something_out_works_with_one_thread():
    found = told(DOORS)
    assert isinstance(found, dict)
    assert len(found) == 9
    for name, (meanwhile, afterwards) in found.items():
        assert meanwhile, name
        assert all(one == [1] for one in meanwhile), name
        assert afterwards == [OURS], name


@pytest.mark.parametrize("name", ["weigh", "reduce_outputs", "run_campaign"])
def test_the_others_are_made_the_same_way(name):
    import aerobalance as ab

    assert getattr(ab, name).__wrapped__.__name__ == name
