"""A calibration stand: dead weights on a balance whose matrix is known, read with noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from aerobalance.balance.load_formats import Geometry
from aerobalance.balance.matrix import BalanceMatrix, TemperatureEffect
from aerobalance.balance.schedule import Schedule
from aerobalance.balance.terms import terms_of
from aerobalance.recording.channel import Array

FORCE_BALANCE: Final = ("N1", "N2", "S1", "S2", "RM", "AF")
CAPACITIES: Final = np.array([11000.0, 11000.0, 5500.0, 5500.0, 560.0, 3100.0])
"""Of a force balance of 2500 lbf class [N, N*m]."""

SIZES: Final = (0.03, 0.006, 0.004, 0.003, 0.003, 0.002, 0.002, 0.002, 0.002, 0.0015)
"""Standard deviation of the coefficients of each kind of term, over the output at capacity."""


def random_balance(seed: int, *, model: str = "96", output: float = 1.1) -> BalanceMatrix:
    """Make a force balance with random interactions of the size that real ones have.

    Parameters
    ----------
    seed
        Seed of the random numbers.
    model
        Whose terms the balance has.
    output
        Output of every bridge at the capacity of its load, about [mV/V].
    """
    generator = np.random.default_rng(seed)
    c = len(FORCE_BALANCE)
    terms = terms_of(model, c)
    C = np.array([generator.normal(0, SIZES[term.kind], c) for term in terms])
    for row, term in enumerate(terms):
        if term.kind == 0:
            C[row, term.first] = 1.0
    return BalanceMatrix(
        components=FORCE_BALANCE,
        gauges=FORCE_BALANCE,
        way="iterative",
        terms=terms,
        coefficients=C,
        load_scale=CAPACITIES,
        output_scale=output * generator.uniform(0.8, 1.2, c),
        covariance=np.zeros((c, len(terms), len(terms))),
        residual_deviation=np.zeros(c),
        residual_correlation=np.eye(c),
        degrees_of_freedom=np.zeros(c, dtype=np.intp),
        calibrated=np.array([-CAPACITIES, CAPACITIES]),
        natural_zero=generator.normal(0, 0.03, c),
        moments=np.array([name == "RM" for name in FORCE_BALANCE]),
        balance_type="force",
        geometry=Geometry(0.12, 0.12, 0.1, 0.1),
    )


class SimulatedCalibration(NamedTuple):
    """What the stand gives.

    Attributes
    ----------
    schedule
        Loads and readings.
    tares
        Loads of the fixtures, shape (s, c) [N, N*m]: the truth.
    """

    schedule: Schedule
    tares: Array


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationStand:
    """Sixteen load series: each component alone, and every pair of components in all four quadrants.

    Attributes
    ----------
    balance
        The balance on the stand.
    noise
        Standard deviation of one reading [mV/V].
    tare_size
        Standard deviation of the fixtures' loads, over capacity.
    natural_zeros
        Whether readings of the bare balance in four roll positions are taken.
    repeats
        How often every series is run through, and the natural zeros are read.
    confirmation
        Share of further random points, kept out of the fit.
    temperature_swing
        Swing of the temperature over the day [K].
    temperature_effects
        What it does to each bridge.
    """

    balance: BalanceMatrix
    noise: float = 0.7e-3
    tare_size: float = 0.02
    natural_zeros: bool = True
    repeats: int = 1
    confirmation: float = 0.0
    temperature_swing: float = 0.0
    temperature_effects: tuple[TemperatureEffect, ...] = ()

    def run(self, seed: int) -> SimulatedCalibration:
        """Load the balance through all series and read it."""
        generator = np.random.default_rng(seed)
        c = len(self.balance.components)
        loads, series = _loads(c)
        loads, series = np.tile(loads, (self.repeats, 1)), np.tile(series, self.repeats)
        held = round(self.confirmation * len(loads))
        if held:
            loads = np.vstack([loads, generator.uniform(-0.9, 0.9, (held, c))])
            series = np.concatenate([series, generator.integers(0, series.max() + 1, held)])
        scale = self.balance.load_scale
        tares = generator.normal(0, self.tare_size, (int(series.max()) + 1, c)) * scale
        # dead weights are what they are, not round parts of capacity
        loads = np.where(loads != 0, loads * generator.uniform(0.97, 1.0, loads.shape), 0.0) * scale
        zero = self.balance.natural_zero if self.balance.natural_zero is not None else np.zeros(c)
        outputs = self.balance.outputs(loads + tares[series])
        temperature = None
        if self.temperature_swing:
            temperature = 20 + self.temperature_swing * np.sin(2 * np.pi * np.arange(len(loads)) / 41)
            outputs = outputs + self._warm(loads, temperature)
        outputs = outputs + zero + generator.normal(0, self.noise, outputs.shape)
        zeros = (
            zero + generator.normal(0, self.noise, (4 * self.repeats, c)) if self.natural_zeros else np.zeros((0, c))
        )
        schedule = Schedule(
            name="simulated calibration",
            components=self.balance.components,
            gauges=self.balance.gauges,
            loads=loads,
            outputs=outputs,
            series=series,
            series_names=tuple(str(number + 1) for number in range(int(series.max()) + 1)),
            points=tuple(f"P-{number + 1:04d}" for number in range(len(loads))),
            capacities=scale,
            moments=self.balance.moments,
            load_units=tuple("N*m" if moment else "N" for moment in self.balance.moments),
            natural_zeros=zeros,
            confirmation=np.arange(len(loads)) >= len(loads) - held,
            temperature=temperature,
            balance_type=self.balance.balance_type,
            geometry=self.balance.geometry,
        )
        return SimulatedCalibration(schedule, tares)

    def without_noise(self) -> CalibrationStand:
        """Return the same stand with perfect readings."""
        return replace(self, noise=0.0)

    def _warm(self, loads: Array, temperature: Array) -> Array:
        x = loads / self.balance.load_scale
        columns = [
            (temperature - effect.reference)
            * (effect.zero + effect.sensitivity * x[:, i] * self.balance.output_scale[i])
            for i, effect in enumerate(self.temperature_effects)
        ]
        return np.column_stack(columns)


def _loads(count: int) -> tuple[Array, np.ndarray[tuple[int], np.dtype[np.intp]]]:
    """Loads over capacity of all series, and the series of each point."""
    steps = (0.0, 0.25, 0.5, 0.75, 1.0, 0.5, 0.0, -0.25, -0.5, -0.75, -1.0, -0.5, 0.0)
    rows = [(0, _point(count, {i: step})) for i in range(count) for step in steps]
    pairs = [(i, j) for i in range(count) for j in range(i + 1, count)]
    for number, (i, j) in enumerate(pairs, 1):
        rows.append((number, _point(count, {})))
        rows += [
            (number, _point(count, {i: sign_i * size_i, j: sign_j * size_j}))
            for sign_i in (1, -1)
            for sign_j in (1, -1)
            for size_i in (0.5, 1.0)
            for size_j in (0.5, 1.0)
        ]
        rows.append((number, _point(count, {})))
    return np.array([row for _, row in rows]), np.array([number for number, _ in rows], dtype=np.intp)


def _point(count: int, loads: dict[int, float]) -> Array:
    row = np.zeros(count)
    for index, value in loads.items():
        row[index] = value
    return row
