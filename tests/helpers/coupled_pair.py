"""Two coupled components, shaken."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import COMPONENTS, si_unit
from aerobalance.recording.recording import Recording

RATE, COUNT = 4000.0, 2000
SIZE = np.array([1000.0, 50.0])
NOISE = 1e-4 * SIZE
UNIT = np.outer(SIZE, 1 / SIZE)


def pair() -> CoupledDynamics:
    """Coupled NF and PM, at some 60 and 170 Hz, with uncertain matrices and an uncertain mass."""
    w = 2 * np.pi * np.array([65.0, 150.0])
    inertia = np.array([[1.0, 0.25], [0.35, 1.0]]) / np.outer(w, w)
    damping = np.array([[0.03, 0.004], [0.006, 0.05]]) / np.sqrt(np.outer(w, w))
    deviation = np.concatenate([2e-4 * np.sqrt(inertia**2).ravel(), 2e-2 * damping.ravel()])
    units = np.tile(UNIT.ravel(), 2)
    mass = RigidMass(6.0, np.array([0.01, 0.0, 0.002]), np.diag([0.01, 0.05, 0.05]))
    known = np.diag((2e-3 * np.array([6.0, 0.01, 0, 0.002, 0.01, 0.05, 0.05, 0, 0, 0])) ** 2)
    return CoupledDynamics(
        ("NF", "PM"),
        inertia * UNIT,
        damping * UNIT,
        np.diag((deviation * units) ** 2),
        replace(mass, covariance=known),
    )


def band(generator: np.random.Generator, edge: float, *, count: int, rate: float, columns: int) -> Array:
    """Noise of a flat spectrum up to an edge, of rms 1, shape (count, columns)."""
    frequency = np.fft.rfftfreq(2 * count, 1 / rate)
    shape = (frequency.size, columns)
    phasors = (generator.normal(size=shape) + 1j * generator.normal(size=shape)) * (
        (frequency > 0) & (frequency < edge)
    )[:, None]
    series = np.fft.irfft(phasors, 2 * count, axis=0)[:count]
    return np.asarray(series / series.std(axis=0))


def recording_of(loads: Array, *, delay: float | tuple[float, float] = 0.0, **more: Array) -> Recording:
    late = zip(("NF", "PM"), loads.T, np.broadcast_to(delay, 2).tolist(), strict=True)
    channels = {name: Channel(name, column, si_unit(name), delay=by) for name, column, by in late}
    channels |= {name: Channel(name, values, "rad") for name, values in more.items()}
    return Recording.from_columns(np.arange(len(loads)) / RATE, channels, name="run")


def shaken(
    generator: np.random.Generator, dynamics: CoupledDynamics, *, pitching: bool = True
) -> tuple[Array, Array, Array]:
    """Force on NF and PM up to 250 Hz, while the balance pitches; the balance loads without noise, and the pitch."""
    fine = 8
    force = 0.03 * SIZE * band(generator, 250, count=fine * COUNT, rate=fine * RATE, columns=2)
    pitch = pitching * (0.1 + 0.05 * np.sin(2 * np.pi * 3 * np.arange(fine * COUNT) / (fine * RATE)))
    assert dynamics.mass is not None
    weight = pitching * dynamics.mass.weight(pitch)[:, [COMPONENTS.index(name) for name in dynamics.components]]
    felt = dynamics.balance_load(force + weight, interval=1 / (fine * RATE))
    return force[::fine], felt[::fine], pitch[::fine]


def colored(generator: np.random.Generator, corners: tuple[float, float], count: int) -> Array:
    """Noise of both channels, white and 1/f below their corners, shape (count, 2)."""
    frequency = np.fft.rfftfreq(4 * count, 1 / RATE)[1:]
    columns = []
    for corner, deviation in zip(corners, NOISE, strict=True):
        size = np.sqrt((1 + corner / frequency) * deviation**2 * 4 * count / 2)
        phasors = size * (generator.normal(size=frequency.size) + 1j * generator.normal(size=frequency.size))
        columns.append(np.fft.irfft(np.concatenate([[0], phasors]), 4 * count)[count : 2 * count])
    return np.column_stack(columns)
