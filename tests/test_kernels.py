"""The compiled loops against the same loops without compilation, line by line."""

from __future__ import annotations

import dis
import importlib
import itertools
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, FrameType, ModuleType
from typing import Any

import numba
import numpy as np
import pytest
from scipy.optimize import minimize

from aerobalance.dynamics.modal import Mode
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.checks import _covariance_kernels, _level_kernels, _root_kernels
from aerobalance.estimation.live import _live_kernels
from aerobalance.estimation.live.filter import KnownShape, LiveFilter
from aerobalance.estimation.spectra import _kernels as spectral_kernels
from aerobalance.estimation.statespace import _kernels, blocks, kalman, model_draws
from aerobalance.estimation.statespace.kalman import FORCE, LOAD, LOAD_RATE, KalmanFilter, StateSpace
from aerobalance.estimation.statespace.model_draws import ModelDraws
from helpers.butterworth import butterworth
from seeds import trials

BALANCE = Dynamics("AF", 177.87, 3.093e7, 8e3, further_modes=(Mode(165.0, 0.2, 0.05),))  # the gain settles soon
NOISE = 200.0
INTERVAL = 1 / 1600
LAG = 32
ROUNDING = np.finfo(np.float64).eps
LINES = (_root_kernels, _level_kernels, _covariance_kernels)
"""Kernels of spectral lines of forces, what is called by others first."""


@pytest.fixture(scope="module")
def plain() -> Iterator[tuple[ModuleType, ...]]:
    """The modules of kernels as they are without compilation."""
    names = [module.__name__ for module in (_kernels, _live_kernels, spectral_kernels, *LINES)]
    compiled = {name: sys.modules.pop(name) for name in names}
    before, numba.config.DISABLE_JIT = numba.config.DISABLE_JIT, 1
    try:
        modules = tuple(importlib.import_module(name) for name in names)
        for kernel in [one for module in modules for one in vars(module).values() if hasattr(one, "handed_over")]:
            kernel.handed_over()
    finally:
        numba.config.DISABLE_JIT = before
        sys.modules.update(compiled)
        for name, module in compiled.items():
            package, _, last = name.rpartition(".")
            setattr(sys.modules[package], last, module)
    yield modules


def system() -> StateSpace:
    force = butterworth(2, cutoff=120.0, density=500.0)
    return StateSpace.of_balance(BALANCE, force, interval=INTERVAL, noise=NOISE, input_density=0.5, swing=30.0)


def whole_record(readings: np.ndarray) -> list[np.ndarray]:
    """All that the kernels of whole records give."""
    present = np.isfinite(readings)
    filled = np.where(present, readings, 0.0)
    kalman_filter = KalmanFilter.of(system(), present)
    states = kalman_filter.smooth(filled[:, None], [LOAD, LOAD_RATE, FORCE])[:, 0]
    force, simulated = (drawn[0] for drawn in ModelDraws.of(system(), present).draw(np.random.default_rng(1), 1))
    return [
        *states.T,
        kalman_filter.smoothed_variance,
        kalman_filter.whiten(filled[:, None]),
        force,
        simulated,
    ]


def live(readings: np.ndarray) -> list[np.ndarray]:
    """All that the live kernels give: a step is found and followed, and readings that are not explained come last."""
    step = BALANCE.step_response((np.arange(2 * LAG) + 1) * INTERVAL)
    one = LiveFilter(system(), interval=INTERVAL, lag=LAG, first=0, step=step)
    one.inflation[[LOAD, LOAD_RATE]] = 9.0
    happened, parts = [], []
    for begin in range(0, readings.size, 50):
        one.feed(readings[begin : begin + 50])
        while one.taken < one.filled:
            what = one.run(one.filled)
            happened.append(float(what))
            if what == _live_kernels.STEP and len(one.shapes) == 1:
                instant = one.likeliest_step()
                load = lambda time, instant=instant: BALANCE.step_response(time - instant)  # noqa: E731
                one.add(
                    KnownShape(load, lambda time, instant=instant: np.heaviside(time - instant, 1.0), instant, 1.0)
                )
                parts.append(one.whiten(one.oldest, instant, load))
            if what != _live_kernels.NOTHING:
                one.look_again(after=one.taken)
                one.give(one.taken - LAG)
    one.give(one.taken)
    _, force, variance = one.collect()
    assert {_live_kernels.NOTHING, _live_kernels.STEP, _live_kernels.STRANGE} <= set(happened)
    residuals, _ = one.residuals(0, one.taken)
    return [force, np.sqrt(variance), residuals, *parts, one.sizes, np.array(happened)]


def record(rng: np.random.Generator) -> np.ndarray:
    readings = rng.normal(0, NOISE, 260)
    readings[[0, 7, *range(40, 45)]] = np.nan
    return readings


def stepped(rng: np.random.Generator) -> np.ndarray:
    """Readings of a quiet force, with gaps, a step, and noise a hundred times as strong in the end."""
    time = np.arange(320) * INTERVAL
    readings = rng.normal(0, NOISE, time.size) + 1e4 * BALANCE.step_response(time - 215.4 * INTERVAL)
    readings[270:] += rng.normal(0, 100 * NOISE, 50)
    readings[[5, *range(12, 18), 190]] = np.nan
    return readings


class Lines:
    """Lines of kernels that were run."""

    def __init__(self, *modules: ModuleType) -> None:
        self.files = {module.__file__ for module in modules}
        self.run: set[tuple[str, int]] = set()

    def of(self, work: Callable[[], list[Any]]) -> list[Any]:
        """What a work gives, with its lines noted; whoever traces all tests (`make coverage`) sees it as well."""
        before = sys.gettrace()
        if before is not None:
            work()
        sys.settrace(self.trace)
        try:
            return work()
        finally:
            sys.settrace(before)

    def trace(self, frame: FrameType, event: str, _: object) -> Callable[..., Any] | None:
        if frame.f_code.co_filename not in self.files:
            return None
        self.run.add((frame.f_code.co_filename, frame.f_lineno))
        return self.trace

    @property
    def missed(self) -> list[str]:
        """Lines of functions that were not run."""
        lines = set()
        for file in self.files:
            module = compile(Path(file).read_text(), file, "exec")
            functions = [one for one in module.co_consts if isinstance(one, CodeType) and one.co_name.islower()]
            for code in functions:
                starts = {line for _, line in dis.findlinestarts(code) if line and line > code.co_firstlineno + 1}
                lines |= {(file, line) for line in starts}
        return [f"{Path(file).name}:{line}" for file, line in sorted(lines - self.run)]


def test_compiled_and_plain_kernels_agree(rng, plain, monkeypatch):
    """And every line of them is run.

    The operations are the same. The compiler sums in another order where it may (weighted innovations, squares of
    residuals), and the two libraries of linear algebra do in products of matrices of d = 6 states. So each sample adds
    at most 4 d roundings, and n samples 4 d n, of the largest value of a result.
    """
    readings, live_readings = record(rng), stepped(rng)
    compiled = [whole_record(readings), live(live_readings)]
    lines = Lines(*plain[:2])
    for module in (kalman, blocks, model_draws):
        monkeypatch.setattr(module, "_kernels", plain[0])
    monkeypatch.setattr("aerobalance.estimation.live.filter.kernels", plain[1])
    interpreted = lines.of(lambda: [whole_record(readings), live(live_readings)])
    for ones, others, count in zip(compiled, interpreted, (readings.size, live_readings.size), strict=True):
        for one, other in zip(ones, others, strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=4 * 6 * count * ROUNDING * np.max(np.abs(one)))
    assert not lines.missed


def spectral(kernels: ModuleType, numbers: tuple[np.ndarray, ...]) -> list[np.ndarray]:
    """All that the kernels of spectra give."""
    costs, levels, points, ordinates = numbers
    moved, best, path = np.zeros(costs.shape, bool), np.zeros(len(costs) + 1, np.int64), np.zeros(len(costs), np.int64)
    total = np.zeros(costs.shape[1])
    kernels.cheapest(costs, 0.7, total, moved, best, path)
    edges = [kernels.averages(levels, fewest, 0.05, 0.5) for fewest in (1, 4)]
    reading = kernels.AveragedReading(ordinates[:2], np.exp(ordinates[2:4]), *np.exp(ordinates[4:]))
    lower, upper, free = np.full(5, -1.5), np.full(5, 1.5), np.ones(points.shape, bool)
    free[0, 3] = False
    lowered, cost = np.clip(points, lower, upper), np.zeros(len(points))
    kernels.lower_roll_offs(lowered, cost, free, reading, kernels.Search(lower, upper, STEPS, 1e-4, 0.8, DAMPING))
    return [total, moved, path, *edges, cost, lowered]


def likely(levels: ModuleType, covariances: ModuleType) -> list[np.ndarray]:
    """Likelihoods of lines of forces: noise in common whole, where it counts, and with noise of a color."""
    found, forces, bands = [np.zeros(5) for _ in range(4)], force_lines(levels), np.array([0, 12, 24, 36, 40])
    for share, one in zip((0.0, 1e-3), found[:2], strict=True):
        levels.likeliest_levels(forces._replace(share=share), bands, 8, 1e-9, one)
    power, search = np.abs(forces.lines) ** 2, spectral_kernels.Search(np.empty(0), np.empty(0), 40, 1e-3, 3.0, 0.01)
    levels.likeliest_levels_and_noise(forces, power, bands, search, found[2])
    lines, noise, covariance = covariance_lines(forces, bands)
    covariances.likeliest_covariances(lines, noise, bands, 4, covariance, found[3])
    return [*found, covariance]


def covariance_lines(forces: Any, bands: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lines of forces, (m, n), covariance of their noise, (m, n, n), and covariances to begin with, (b, n, n)."""
    lines = np.ascontiguousarray(forces.lines.T)
    noise = np.ascontiguousarray((forces.rows * forces.noise) @ forces.rows.conj().transpose(0, 2, 1))
    count = np.diff(np.append(bands, len(lines)))[:, None, None]
    return lines, noise, np.add.reduceat(lines[:, :, None] * lines[:, None, :].conj(), bands) / count


def test_covariances_are_those_of_expectation_and_maximisation():
    """As the method is written down, with an inverse and a determinant of every ordinate [Dempster1977]."""
    bands = np.array([0, 12, 24, 36, 40])
    lines, noise, covariance = covariance_lines(force_lines(_level_kernels), bands)
    found, moved = np.empty(5), covariance.copy()
    _covariance_kernels.likeliest_covariances(lines, noise, bands, 10, moved, found)
    for band in (0, 1, 3):  # of lines that are noise alone a covariance is the difference of numbers nearly alike
        first, last = bands[band], bands[band + 1]
        own, spent = covariance[band], []
        for _ in range(10):
            expected, cost = np.zeros_like(own), 0.0
            for place in range(first, last):
                line, whole = lines[place], own + noise[place]
                passed = own @ np.linalg.inv(whole)
                force = passed @ line
                expected += np.outer(force, force.conj()) + own - passed @ own
                cost += np.linalg.slogdet(whole)[1] + float(np.real(line.conj() @ np.linalg.solve(whole, line)))
            own = expected / (last - first)
            spent.append(cost)
        rounding = 10 * float(np.linalg.cond(covariance[band] + noise[first])) * ROUNDING  # of ten rounds
        assert all(later < earlier + rounding * abs(earlier) for earlier, later in itertools.pairwise(spent))
        assert found[band] == pytest.approx(-spent[-1], rel=rounding)
        np.testing.assert_allclose(moved[band], own, rtol=0, atol=rounding * np.abs(own).max())


def test_a_covariance_of_one_strong_load_stays_one():
    """1e4 times the noise in all lines, as of a release: no level is below zero, and each round is likelier."""
    rng = np.random.default_rng(8)
    load = 1e4 * (rng.normal(size=(40, 1)) + 1j * rng.normal(size=(40, 1)))
    lines = load @ rng.normal(size=(1, 6)) + rng.normal(size=(40, 6)) + 1j * rng.normal(size=(40, 6))
    noise, bands = np.tile(2 * np.eye(6, dtype=complex), (40, 1, 1)), np.array([0])
    begun, found = (lines.T @ lines.conj() / 40)[None], []
    for rounds in range(1, 11):
        covariance, one = begun.copy(), np.empty(1)
        _covariance_kernels.likeliest_covariances(lines, noise, bands, rounds, covariance, one)
        level = np.linalg.eigvalsh(covariance[0])
        assert level[0] > -6 * ROUNDING * level[-1]
        found.append(float(one[0]))
    assert all(later > earlier for earlier, later in itertools.pairwise(found))


def force_lines(kernels: ModuleType) -> Any:
    """Lines of three forces in five bands: noise in common hides two, one or all of them; the last is not told."""
    rng = np.random.default_rng(6)
    count = 44
    rows = np.eye(3) + 0.3 * rng.normal(size=(count, 3, 3)) + 0.02j * rng.normal(size=(count, 3, 3))
    rows[:, 1, 0], rows[:, 2, 0] = 30.0, 10.0  # noise of the first channel
    noise, gain = np.array([1.0, 1e-2, 1e-4]), rng.uniform(0.5, 2.0, size=(3, count))
    level = np.repeat([[30.0, 1.0, 0.0], [1e5, 1e4, 1e5], [0.0, 0.0, 0.0], [3.0, 1e3, 0.1]], [12, 12, 12, 8], axis=0)
    drawn = rng.normal(size=(2, 3, count)) + 1j * rng.normal(size=(2, 3, count))
    lines = drawn[0] * np.sqrt(level.T * gain / 2)
    lines += np.einsum("mij,j,jm->im", rows, np.sqrt(noise / 2), drawn[1])
    told = np.arange(count) < 40
    told[5] = False
    return kernels.ForceLines(lines, rows, noise, gain, told, 0.0)


@pytest.mark.soak(first=1)
@pytest.mark.parametrize("colored", [False, True])
def test_levels_of_forces_are_the_likeliest(colored, rng):
    """Against a search by a library for the least of the same likelihood, written out with a determinant and inverse.

    The lines' covariance is diag(gain * level) + W (R + E) W^H, E zero or as likely as it can be as well. Of one band
    less than 1e-6 is left to gain, or with E 0.05: where levels go to zero the library ends 0.02 beside.
    """
    forces, bands = force_lines(_level_kernels), [0, 12, 24, 36, 40]
    found = np.zeros(5)
    if colored:
        channels = np.linalg.solve(forces.rows, forces.lines.T[..., None])[..., 0].T
        search = spectral_kernels.Search(np.empty(0), np.empty(0), 300, 1e-6, 3.0, 0.01)
        power = np.ascontiguousarray(np.abs(channels) ** 2)
        _level_kernels.likeliest_levels_and_noise(forces, power, np.array(bands), search, found)
    else:
        _level_kernels.likeliest_levels(forces, np.array(bands), 30, 1e-9, found)

    def lost(logarithms: np.ndarray, places: np.ndarray) -> float:
        rows, lines = forces.rows[places], forces.lines[:, places].T
        logarithms = np.clip(logarithms, -40, 15)
        noise = forces.noise + (np.exp(logarithms[3:]) if colored else 0.0)
        covariance = (rows * noise) @ rows.conj().transpose(0, 2, 1)
        covariance[:, range(3), range(3)] += np.exp(logarithms[:3]) * forces.gain[:, places].T
        solved = np.linalg.solve(covariance, lines[..., None])[..., 0]
        return float(np.sum(np.linalg.slogdet(covariance)[1]) + np.sum(lines.conj() * solved).real)

    for one, (first, last) in enumerate(itertools.pairwise(bands)):
        places = np.arange(first, last)[forces.told[first:last]]
        starts = rng.uniform(-8, 12, size=(trials(3, 8), 6 if colored else 3))
        tried = [minimize(lost, start, (places,), method="Nelder-Mead", options=FINE) for start in starts]
        if colored:  # of six numbers, some of them zero, a simplex may end early
            within = [(-40.0, 15.0)] * 6
            tried += [minimize(lost, start, (places,), method="L-BFGS-B", bounds=within) for start in starts]
            again = min(tried, key=lambda end: end.fun).x
            tried += [minimize(lost, again, (places,), method="Nelder-Mead", options=FINE)]
        least = min(end.fun for end in tried)
        assert -found[one] == pytest.approx(least, abs=0.05 if colored else 1e-5)
    assert found[4] == 0


FINE = {"xatol": 1e-6, "fatol": 1e-9, "maxfev": 4000}


STEPS, DAMPING = 6, 1e-3
"""Of a search for a spectrum."""


def test_compiled_and_plain_kernels_of_spectra_agree(rng, plain):
    """Each of n = 40 ordinates adds some 100 roundings to sums that may cancel: of their largest value.

    A step of a search is as many times less exact as its equations are badly conditioned, which their damping limits.
    """
    numbers = rng.exponential(size=(30, 6)), np.cumsum(rng.normal(0, 0.2, 80)), rng.normal(size=(8, 5))
    numbers += (rng.normal(size=(7, 40)),)
    lines = Lines(*plain[2:])
    interpreted = lines.of(lambda: spectral(plain[2], numbers) + likely(*plain[4:]))
    compiled = spectral(spectral_kernels, numbers) + likely(*LINES[1:])
    for one, other in zip(compiled, interpreted, strict=True):
        roundings = 100 * 40 * STEPS * 5 / DAMPING
        np.testing.assert_allclose(one, other, rtol=0, atol=roundings * ROUNDING * np.max(np.abs(one)))
    assert not lines.missed


def test_a_damped_step_solves_its_equations(plain, rng):
    """The step s of (H + d diag(H)) s = -g, by a library: of all numbers, and of some where one has its step."""
    root = rng.normal(size=(5, 5))
    information, slope, damping = root @ root.T, rng.normal(size=5), 0.1
    solve = plain[2].solve_damped  # what is compiled for other loops alone cannot be called from here
    for going in (np.ones(5, bool), np.arange(5) != 2):
        step, stopped = np.empty(5), np.where(going, 0.0, 0.7)
        solve(slope, np.tril(information), going, stopped, damping, np.empty((5, 5)), step)
        damped = information + damping * np.diag(np.diag(information))
        expected = stopped.copy()
        left = slope + information @ stopped
        expected[going] = -np.linalg.solve(damped[np.ix_(going, going)], left[going])
        # 1e-9 is added to the diagonal, so that a number of no effect has a step of none
        room = 1e-9 * np.linalg.norm(np.linalg.inv(damped), 2) * np.linalg.norm(expected)
        np.testing.assert_allclose(step, expected, rtol=1e-10, atol=room)


def test_the_cheapest_path_is_that_of_trying_all(rng):
    costs, price = rng.exponential(size=(6, 3)), 0.4
    moved, best, path = np.zeros(costs.shape, bool), np.zeros(7, np.int64), np.zeros(6, np.int64)
    spectral_kernels.cheapest(costs, price, np.zeros(3), moved, best, path)

    def paid(way: tuple[int, ...]) -> float:
        return sum(costs[range(6), way]) + price * np.count_nonzero(np.diff(way))

    assert tuple(path) == min(itertools.product(range(3), repeat=6), key=paid)
