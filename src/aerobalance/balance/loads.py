"""The loads that a balance feels, Eq. (2) of [Gorbushin2020]_, with their zeros, tares and uncertainty.

References
----------
.. [Gorbushin2020] A. R. Gorbushin, A. A. Bolshakova, "Unsteady axial force measurement by the strain gauge balance",
   Measurement 152 (2020) 107381. https://doi.org/10.1016/j.measurement.2019.107381
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.load_variance import load_variances
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.matrix_errors import MatrixErrors
from aerobalance.balance.zeros import REPEATS, GaugeZero, delay_of_outputs
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import COMPONENTS, is_gauge
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import FitError, argument
from aerobalance.recording.gravity import GravityOnZero
from aerobalance.recording.linalg import whole_rows
from aerobalance.recording.recording import Recording


class Tare(NamedTuple):
    """Loads to take off: weight by a weighing, or those without wind.

    Attributes
    ----------
    values, u
        In the components of the loads that they are taken off, and their standard uncertainty, shape (n, c) or, where
        they are constant, (1, c) [N, N*m].
    correlation
        Of the errors of components, the mean over the samples, shape (c, c); of the same readings all have theirs.
    from_zero
        Whether they count from the zero that the loads do, so that its error is in neither.
    """

    values: Array
    u: Array
    correlation: Array
    from_zero: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Loads:
    """Balance loads, with all that is known of their errors: n samples, c components.

    Attributes
    ----------
    components
        Names: NF PM SF YM RM AF where the gauges' places are known, else those of the balance.
    units
        ``"N"`` or ``"N*m"`` of each.
    values
        Shape (n, c) [N, N*m]; NaN where an output is missing.
    noise_covariance
        Covariance of one reading from the noise of the gauges, shape (c, c) [N^2, N^2*m, N^2*m^2].
    apart
        Variance of every sample from zeros, tares, gains of the bridges and what temperature does to them
        [N^2, N^2*m^2], shape (n, c) or, the same for all, (1, c).
    of_tare
        Covariance of the components by tares, the mean over the samples, shape (c, c) [N^2, N^2*m, N^2*m^2]; runs with
        other tares do not share it.
    of_zero
        Variance of the outputs by their zeros, shape (c,) [(mV/V)^2]; where a tare counts from the same zero, only by
        how that moved meanwhile.
    native
        Loads in the balance's own components, tares not removed, shape (n, c) [N, N*m].
    beyond
        Samples outside the calibrated range, by the balance's own components.
    contraction
        Largest contraction factor of the iteration ([R091]_ converges below 1) [1].
    zero
        The gauge zeros that were taken.
    transform
        Matrix from the balance's own components to those of the result, shape (c, c) [1; m or 1/m between forces and
        moments].
    balance
        The matrix that they were worked out with.
    recording
        The run, these loads in the place of its gauge outputs: the clock, motion and attitude that go with them.
    ready
        Whether gravity is in the loads and in the recording alike, as the force needs it.
    doubts
        What their zeros say against them.
    stuck, clipped
        Readings of the bridges that repeat the one before, or rest on a limit of the channel, in the order of the
        balance's bridges, shape (n, c); None where there are none.
    """

    components: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    noise_covariance: Array
    apart: Array
    of_tare: Array
    of_zero: Array
    native: Array
    beyond: Mapping[str, int]
    contraction: float
    zero: GaugeZero
    transform: Array
    balance: BalanceMatrix
    recording: Recording
    ready: bool
    doubts: tuple[Doubt, ...] = ()
    stuck: NDArray[np.bool_] | None = None
    clipped: NDArray[np.bool_] | None = None

    def __repr__(self) -> str:
        means = zip(self.components, np.nanmean(self.values, axis=0), self.units, strict=True)
        told = ", ".join(f"{name} {mean:.6g} {unit}" for name, mean, unit in means)
        return f"balance loads of {self.name}, {self.samples} samples; means {told}"

    @property
    def noise(self) -> Array:
        """Standard uncertainty of one reading from the noise of the gauges, shape (c,) [N, N*m]."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.noise_covariance), 0.0)))

    @property
    def calibration(self) -> Array:
        """Standard uncertainty from the matrix and all that `apart` has, shape (n, c) [N, N*m]; worked out anew."""
        return np.asarray(np.sqrt(np.maximum(_from_matrix(self, self.native) + self.apart, 0.0)))

    @property
    def uncertainty(self) -> Array:
        """Standard uncertainty of every sample, noise and calibration together, shape (n, c) [N, N*m]."""
        return np.asarray(np.hypot(self.calibration, self.noise))

    @property
    def matrix_errors(self) -> MatrixErrors:
        """Where the matrix was used: how errors of its coefficients change these loads."""
        return MatrixErrors(self.balance, self.components, self.transform, self.native)

    @property
    def name(self) -> str:
        """What the run is called in messages."""
        return self.recording.name

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.values)

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]."""
        return self.recording.rate

    @property
    def start(self) -> float:
        """Time of the first sample [s]."""
        return self.recording.start

    @property
    def epoch(self) -> np.datetime64 | None:
        """Date and time at which the time is zero; None where that is not known."""
        return self.recording.epoch

    def part(self, begin: int, end: int) -> Loads:
        """The loads of the samples from one to another (not included)."""
        own = slice(begin, end)
        return replace(
            self,
            values=self.values[own],
            apart=self.apart if len(self.apart) == 1 else self.apart[own],
            native=self.native[own],
            recording=self.recording.part(begin, end),
            stuck=None if self.stuck is None else self.stuck[own],
            clipped=None if self.clipped is None else self.clipped[own],
        )

    def sparse(self, every: int) -> Loads:
        """Every so many of the samples, without their recording."""
        return replace(
            self,
            values=self.values[::every],
            apart=self.apart if len(self.apart) == 1 else self.apart[::every],
            native=self.native[::every],
            stuck=None if self.stuck is None else self.stuck[::every],
            clipped=None if self.clipped is None else self.clipped[::every],
        )

    @property
    def without_weight_of_zero(self) -> Loads:
        """The same less the weight in their zero, as a run of no known attitude is taken to have that of its zero."""
        zero = self.zero
        own = [zero.weight[COMPONENTS.index(name)] if name in COMPONENTS else 0.0 for name in self.components]
        counted = replace(zero, pull=GravityOnZero())
        return self._with(self.values - np.array(own), counted)

    @property
    def without_gravity(self) -> Loads:
        """The same with no angles in the recording: the wind-off loads that were taken off have the weight in them.

        Raises
        ------
        FitError
            A channel of the recording reads gravity as well.
        """
        for channel in self.recording:
            if channel.coupling == "dc":
                raise FitError(
                    f"{self.recording.name}: {channel.name} is dc-coupled and reads gravity, which "
                    f"{argument('tare')} has taken off too; give the zero with {argument('zero')} and leave the "
                    "weight to the dynamics"
                )
        channels = {name: one for name, one in self.recording.channels.items() if name not in ("pitch", "roll")}
        return replace(self, recording=replace(self.recording, channels=channels))

    def check_ready(self) -> None:
        """Make sure that a force can be worked out from the loads.

        Raises
        ------
        ValueError
            They lack the weight of the model, which the dynamics would take off once more.
        """
        if not self.ready:
            raise ValueError(
                f"{self.recording.name}: these loads lack the weight of the model, as it hung on the balance while "
                "their zero was read, or was taken off; the dynamics would take it off once more. Work the loads out "
                "with the dynamics as their model (model=dynamics), or give estimate_force the gauge outputs with "
                "balance and zero"
            )

    def _with(self, values: Array, zero: GaugeZero) -> Loads:
        changed = replace(self, values=values, zero=zero)
        return replace(changed, recording=with_loads(self.recording, changed))


def _from_matrix(felt: Loads, native: Array) -> Array:
    """Variance that the matrix gives to loads in the balance's own components, shape (n, c); NaN where one is."""
    found = load_variances(felt.balance, np.nan_to_num(native), transform=felt.transform)
    found[~whole_rows(felt.native)] = np.nan
    return found


def static_uncertainty(felt: Loads, *, forces: Mapping[str, Array]) -> dict[str, Array]:
    """Standard uncertainty that the calibration gives to static loads of the size of forces, by component.

    Parameters
    ----------
    felt
        Balance loads; they stand for the components that `forces` lacks.
    forces
        Forces applied, shape (n,) each [N, N*m].
    """
    columns = [forces.get(name, felt.values[:, i]) for i, name in enumerate(felt.components)]
    # what zeros and tares add does not depend on the load
    T = felt.transform
    offset = felt.native @ T.T - felt.values
    native = np.asarray(np.linalg.solve(T, (np.column_stack(columns) + np.nan_to_num(offset)).T).T)

    u = np.sqrt(np.maximum(felt.apart, 0.0) + _from_matrix(felt, native))
    return {name: u[:, i] for i, name in enumerate(felt.components)}


def with_loads(recording: Recording, felt: Loads) -> Recording:
    """The recording, balance loads in the place of its gauge outputs."""
    gauges = {name for name in recording.channels if is_gauge(name)}
    supply = {"excitation"} & set(recording.channels)
    channels = {name: channel for name, channel in recording.channels.items() if name not in gauges | supply}
    # loads whose zero has changed are in the recording already
    delay = delay_of_outputs(recording) if gauges else recording.channel(felt.components[0]).delay
    for index, (name, unit) in enumerate(zip(felt.components, felt.units, strict=True)):
        noise = float(felt.noise[index])
        channels[name] = Channel(name, felt.values[:, index], unit, noise=noise or None, delay=delay, file_unit=unit)
    declared = recording.declared | (set(felt.components) if gauges and gauges <= recording.declared else set())
    # every bridge has a part in every load: the lowest filter of theirs is what limits it
    own = [recording.low_passed[name] for name in gauges if name in recording.low_passed]
    lowest = min(own, key=lambda one: one.corner, default=None)
    low_passed = dict.fromkeys(felt.components, lowest) if lowest is not None else recording.low_passed
    half = np.abs(felt.transform) @ (np.ptp(np.array(felt.balance.calibrated), axis=0) / 2)
    stated = any(recording.channels[name].relative_uncertainty > 0 for name in (*gauges, *supply))
    once = not felt.zero.drift.any()  # no zero was read after the run
    zeros = np.abs(felt.transform @ natural_loads(felt))
    repeats = dict(zip(felt.components, (REPEATS * half).tolist(), strict=True)) if once else {}
    return replace(
        recording,
        channels=channels,
        low_passed=low_passed,
        gravity_on_zero=felt.zero.pull,
        from_outputs=True,
        gains_stated=recording.gains_stated or stated,
        declared=declared,
        zero_from_natural={name: one.load for name, one in felt.zero.from_natural.items() if one.of_range > REPEATS},
        zeros_left={name: left for name, left in zip(felt.components, zeros.tolist(), strict=True) if left},
        zero_repeats=repeats,
    )


def natural_loads(felt: Loads) -> Array:
    """Return loads of the natural zeros where none is taken off, in the balance's components, shape (c,) [N, N*m]."""
    natural = felt.balance.natural_zero
    if natural is None or not felt.zero.is_nothing:
        return np.zeros(len(felt.balance.components))
    return np.asarray(np.nan_to_num(felt.balance.loads(natural[None, :]).loads[0]))
