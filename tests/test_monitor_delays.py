"""Delays of channels, as a set-up gives them, are taken out of the live force."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from aerobalance.acquisition.setup import setup_from, stored_channels
from aerobalance.acquisition.simulated import RigSettings, SimulatedSource, rig_dynamics
from aerobalance.acquisition.source import Block
from aerobalance.app.monitor.view import Panel, View
from aerobalance.dynamics.independent import dynamics_of
from aerobalance.io.hdf5_layout import StoredChannel
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import ReadError
from aerobalance.simulation.calibration_stand import CAPACITIES
from aerobalance.simulation.calibration_stand import random_balance as calibrated
from aerobalance.simulation.published import VIBRATION_RIG

RATE = 25_000.0
DYNAMICS = VIBRATION_RIG.dynamics


def shaken(seed, *, load_late=0.0, ground_late=0.0):
    """Load [N] and acceleration [m/s^2] of a balance shaken near resonance, each read late by so much [s]."""
    time = np.arange(round(0.8 * RATE)) / RATE
    felt, ground = np.zeros(time.size), np.zeros(time.size)
    for frequency, amplitude in ((570.0, 20.0), (131.0, 30.0)):
        turn = 2j * np.pi * frequency
        response = complex(DYNAMICS.response(np.array([frequency]))[0])
        ground += np.real(amplitude * np.exp(turn * (time - ground_late)))
        felt -= np.real(DYNAMICS.mass * response * amplitude * np.exp(turn * (time - load_late)))
    noise = np.random.default_rng(seed).normal(size=(2, time.size))
    return np.column_stack((felt + 0.05 * noise[0], ground + 0.05 * noise[1]))


def force_of(samples, *, delays=(0.0, 0.0), cuts=500):
    channels = (
        StoredChannel("AF", "N", delay=delays[0]),
        StoredChannel("ground_acceleration", "m/s^2", delay=delays[1]),
    )
    view = View(Panel(channels, RATE, True, dynamics_of(DYNAMICS), {}, {}))
    found, tick = [], 0
    edges = np.arange(0, len(samples), cuts) if isinstance(cuts, int) else cuts
    for part in np.split(samples, edges):
        if len(part):
            view.feed(Block(tick, part, 0.0))
            tick += len(part)
            found += [bins.least[:, 0] for bins in view.take().forces.get("AF", ())]
    return np.concatenate(found)


@pytest.mark.parametrize("late", [(0.0, 37e-6), (53e-6, 0.0), (120e-6, 20e-6)])
@pytest.mark.soak(first=1)
def test_delays_are_taken_out_of_the_force(late, seed) -> None:
    there = force_of(shaken(seed))
    load_late, ground_late = late
    samples = shaken(seed, load_late=load_late, ground_late=ground_late)
    aligned, not_aligned = force_of(samples, delays=late), force_of(samples)
    count = min(there.size, aligned.size)
    after = slice(count // 2, count)
    # no force is applied: what is left is noise, and as much of it whether channels are late or not
    quiet = np.std(there[after])
    assert np.std(aligned[after]) == pytest.approx(quiet, rel=0.2)
    assert np.std(not_aligned[after]) > 5 * quiet


def test_chunks_make_no_difference(rng, seed) -> None:
    late = (61e-6, 0.0)
    samples = shaken(seed, load_late=late[0])[:12_000]
    # whether the ground end moves is judged when 0.25 s have come, from as much as there is then
    whole = force_of(samples, delays=late, cuts=[7000])
    for _ in range(3):
        cuts = np.sort(np.append(rng.integers(7000, len(samples), 40), 7000))
        cut = force_of(samples, delays=late, cuts=cuts)
        assert cut.tobytes() == whole.tobytes()


def test_delays_are_taken_out_of_forces_that_ring_together(seed) -> None:
    source = SimulatedSource(RigSettings(rig="six", speed=math.inf, seed=seed, noise=0.1, rate=6000.0))
    source.start()
    source.control("shake", 2.0)
    channels = stored_channels(setup_from({}), source.channels)
    whole = np.concatenate([source.read(1.0).samples for _ in range(80)])
    lags = np.random.default_rng(seed).integers(0, 5, len(channels))
    lags[0] = 0
    late = np.column_stack([np.roll(column, lag) for column, lag in zip(whole.T, lags, strict=True)])[5:]
    delayed = tuple(replace(one, delay=lag / 6000.0) for one, lag in zip(channels, lags, strict=True))
    forces = []
    for given, rows in ((channels, whole[5:]), (delayed, late)):
        view = View(Panel(given, 6000.0, True, rig_dynamics("six"), {}, {}))
        view.feed(Block(0, rows, 0.0))
        found = view.take().forces
        forces.append({name: np.concatenate([bins.least[:, 0] for bins in parts]) for name, parts in found.items()})
    there, aligned = forces
    assert set(there) == set(aligned) and len(there) == 6
    for name, force in there.items():
        count = min(force.size, aligned[name].size)
        # the first samples are held where those before them are not there, which is forgotten by and by
        after = slice(count // 2, count)
        assert np.std(aligned[name][after] - force[after]) < 0.05 * np.std(force[after]), name


def test_gauge_outputs_read_one_after_the_other_are_brought_together(seed) -> None:
    """N1 and N2 of one normal force, 1 ms apart: a moment that is not there unless they are aligned."""
    rate, late = 6000.0, 3
    balance = replace(calibrated(seed), natural_zero=None)
    generator = np.random.default_rng(seed)
    swing = np.sin(2 * np.pi * 25.0 * np.arange(15_000) / rate)[:, None]
    native = 0.3 * CAPACITIES * np.array([1.0, 1.0, 0, 0, 0, 0]) * swing
    outputs = balance.outputs(native) + 1e-5 * generator.normal(size=native.shape)
    delays = late * np.array([-1.0, 1.0, 0.0, 0.0, 0.0, 0.0]) / rate
    moved = [np.roll(outputs[:, 0], -late), np.roll(outputs[:, 1], late), outputs[:, 2:]]
    behind = np.column_stack(moved)[late:-late]

    def forces(rows: Array, delays: Array, cut: int) -> dict[str, Array]:
        channels = tuple(
            StoredChannel(f"r{gauge}", "mV/V", delay=float(by))
            for gauge, by in zip(balance.gauges, delays, strict=True)
        )
        view = View(Panel(channels, rate, True, rig_dynamics("six"), {}, {}, balance=balance))
        found: dict[str, list[Array]] = {}
        for tick in range(0, len(rows), cut):
            view.feed(Block(tick, rows[tick : tick + cut], 0.0))
            for name, parts in view.take().forces.items():
                found.setdefault(name, []).extend(bins.least[:, 0] for bins in parts)
        return {name: np.concatenate(parts) for name, parts in found.items()}

    there = forces(outputs[late:-late], np.zeros(6), 500)
    aligned, ignored = forces(behind, delays, 500), forces(behind, np.zeros(6), 500)
    other = forces(behind, delays, 1100)
    assert set(there) == set(COMPONENTS)
    for name in COMPONENTS:
        assert np.array_equal(aligned[name][: other[name].size], other[name][: aligned[name].size])
    count = min(part["PM"].size for part in (there, aligned, ignored))
    after = slice(count // 2, count)
    kept, wrong = (np.std(part["PM"][after] - there["PM"][after]) for part in (aligned, ignored))
    assert kept < 0.02 * wrong


def test_loads_and_limits_of_the_page_are_those_of_gauges_at_one_instant(seed) -> None:
    """N1 and N2 of one normal force, 1.5 samples early and late: a moment that is not there, and over its limit."""
    rate, late, frequency = 6000.0, 1.5, 150.0
    balance = replace(calibrated(seed), natural_zero=None)
    size = 0.3 * CAPACITIES * np.array([1.0, 1.0, 0, 0, 0, 0])
    lags = late * np.array([-1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    count = np.arange(3000)[:, None]

    def outputs(by: Array) -> Array:
        """What each gauge reads late by so many samples."""
        swings = [size * np.sin(2 * np.pi * frequency * (count - one) / rate) for one in by]
        return np.column_stack([balance.outputs(swing)[:, place] for place, swing in enumerate(swings)])

    def shown(rows: Array, delays: Array, limits: dict[str, tuple[float, float]]) -> tuple[View, Array]:
        channels = tuple(
            StoredChannel(f"r{gauge}", "mV/V", delay=float(by) / rate)
            for gauge, by in zip(balance.gauges, delays, strict=True)
        )
        view = View(Panel(channels, rate, True, dynamics_of(DYNAMICS), {}, limits, balance=balance))
        for tick in range(0, len(rows), 500):
            view.feed(Block(tick, rows[tick : tick + 500], (tick + 499) / rate))
        return view, np.concatenate([bins.largest for bins in view.update.raw])[-50:].max(axis=0)

    view, chart = shown(outputs(0 * lags), 0 * lags, {})
    there = view.update.readings
    limits = {"PM": (-0.005 * CAPACITIES[0], 0.005 * CAPACITIES[0])}
    ignored, _ = shown(outputs(lags), 0 * lags, limits)
    delayed, aligned = shown(outputs(lags), lags, limits)
    assert ignored.update.readings["PM"].state == "over"
    assert delayed.update.readings["PM"].state == "ok"
    # below half of the Nyquist frequency the interpolation errs by less than 1e-3 (see test_live_alignment)
    for place, name in enumerate(view.panel.names):
        size = 1e-3 * there["NF"].largest if name in view.panel.loads else 1e-2 * there[name].largest
        assert delayed.update.readings[name].largest == pytest.approx(there[name].largest, abs=size), name
        assert aligned[place] == pytest.approx(chart[place], abs=size), name
    # rows that wait for gauge outputs after them are of the time at which they were read
    assert delayed.means_since == pytest.approx(0, abs=1e-9)


def test_a_delay_that_cannot_be_is_refused() -> None:
    with pytest.raises(ReadError, match=r"channels\.AF.*delay.*at most 1 s"):
        setup_from({"channels": {"AF": {"delay": 40.0}}})
