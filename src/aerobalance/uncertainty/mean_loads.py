"""The mean force of a run, with the covariance of its components by what runs share of it.

Errors of the calibration, the dynamics and gravity are the same in all runs of a set-up; those of a zero or a tare in
all runs that count from it; noise, and what a fluctuating load has by chance in so short a record, are drawn anew in
each. Only the latter make repeat runs scatter, so they are kept apart through all axes up to the coefficients.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.loads import Loads
from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.dynamics.independent import IndependentDynamics
from aerobalance.estimation.applied_force import Force
from aerobalance.estimation.error_sources import Contribution, Divided, Noise, Systematic, added
from aerobalance.estimation.result import ComponentForce
from aerobalance.recording.channel import Array
from aerobalance.recording.doubts import DOUBTED
from aerobalance.recording.errors import FitError
from aerobalance.uncertainty.regression import TAPERS, regress

OF_BALANCE: Final = "balance matrix, zeros and tares"
"""Contribution that is worked out anew here, for all components together."""

OF_ANGLES: Final = tuple((f"{angle} {what}", angle) for angle in ("pitch", "roll") for what in ("zero", "gain"))
"""Names and sources of what the sensors of the angles have wrong, by which the weight is taken off the loads."""

DYNAMICS: Final = "dynamics"
"""Source of what the dynamics contribute."""

OF_ONE_RUN: Final = ("alignment", "gap in", DOUBTED)
"""How contributions begin that hold along a record and belong to it alone."""

CERTAIN: Final = 1e6
"""Degrees of freedom of what counts as known exactly."""


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Covariance of k quantities of a run, by what runs share of it, shape (k, k) each.

    Attributes
    ----------
    common
        The same error in all runs of a set-up.
    zero
        The same in all runs that count from one zero.
    tare
        The same in all runs that the same wind-off recordings were taken off.
    run
        Drawn anew in each run.
    scatter
        Drawn anew in each run, and estimated from its fluctuations.
    """

    common: Array
    zero: Array
    tare: Array
    run: Array
    scatter: Array

    @property
    def whole(self) -> Array:
        """All together, shape (k, k)."""
        return self.common + self.zero + self.tare + self.run + self.scatter

    @property
    def parts(self) -> dict[str, Array]:
        """The parts by name."""
        return {one.name: getattr(self, one.name) for one in fields(self)}

    def uncertainty(self) -> Array:
        """Standard uncertainty, shape (k,)."""
        return np.sqrt(np.maximum(np.diag(self.whole), 0.0))

    def of_run(self) -> Array:
        """Standard deviation by which repeat runs with the same zero and tare scatter, shape (k,)."""
        return np.sqrt(np.maximum(np.diag(self.run + self.scatter), 0.0))

    def of_zero(self) -> Array:
        """Standard uncertainty by the zero, shape (k,)."""
        return np.sqrt(np.maximum(np.diag(self.zero), 0.0))

    def of_tare(self) -> Array:
        """Standard uncertainty by the tare, shape (k,)."""
        return np.sqrt(np.maximum(np.diag(self.tare), 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class MeanLoads:
    """Mean force of a run along c components [N, N*m].

    Attributes
    ----------
    components
        Which.
    values
        Shape (c,).
    errors
        Their covariance.
    freedom
        Degrees of freedom of the scatter: it is estimated from the record.
    by_sensors
        What the standard uncertainty of each error of the sensors of the angles makes of the means, shape (c,); by the
        name of the error, such as ``pitch zero``. It is in the common part of `errors`.
    """

    components: tuple[str, ...]
    values: Array
    errors: Errors
    freedom: float
    by_sensors: Mapping[str, Array] = field(default_factory=dict)


def mean_loads(force: Force) -> MeanLoads:
    """Mean of the forces of a run [N, N*m], as an estimate of the steady load, with the covariance of its errors.

    Parameters
    ----------
    force
        The forces.
    """
    names = force.components
    parts = [force[name] for name in names]
    present = np.logical_and.reduce([np.isfinite(part.values) for part in parts])
    weights = present / np.count_nonzero(present)
    values = np.array([float(weights @ np.where(present, part.values, 0.0)) for part in parts])
    common, run = np.zeros((2, len(names), len(names)))
    shared = [_common(part, weights) for part in parts]
    for i, one in enumerate(parts):
        common[i, i], run[i, i] = (_variance(one, weights, kind=kind) for kind in ("common", "run"))
        for j in range(i):
            alike = _alike(force.dynamics, names[i], names[j])
            common[i, j] = common[j, i] = _covariance(shared[i], shared[j], of_dynamics=alike)
    zero, tare = np.zeros_like(common), np.zeros_like(common)
    loads = force.loads
    if loads is None:
        common += np.diag([_variance(part, weights, kind="balance") for part in parts])
    else:
        matrix, zero, tare = _of_matrix(loads, names, present)
        common += matrix
        run = _correlated(run, loads, names)
    scatter, freedom = _scatter(parts, present)
    by_sensors = {key[0]: np.array([one[key][0, 0] if key in one else 0.0 for one in shared]) for key in OF_ANGLES}
    return MeanLoads(names, values, Errors(common, zero, tare, run, scatter), freedom, by_sensors)


def _pieces(part: Contribution) -> Sequence[tuple[int, Systematic | Noise]]:
    return part.pieces if isinstance(part, Divided) else [(0, part)]


def _kind(part: Systematic | Noise) -> str:
    """Whether an error is the same in all runs."""
    if part.name == OF_BALANCE:
        return "balance"
    own = isinstance(part, Noise) or part.local or part.name.startswith(OF_ONE_RUN)
    return "run" if own else "common"


def _variance(one: ComponentForce, weights: Array, *, kind: str) -> float:
    """Variance of the mean of a component by errors of a kind [N^2, (N*m)^2]."""
    return sum(
        float(part.covariance_of(weights[None])[0, 0])
        for part in one.contributions
        if any(_kind(piece) == kind for _, piece in _pieces(part))
    )


def _common(one: ComponentForce, weights: Array) -> dict[tuple[str, str], Array]:
    """Return the error of a mean per independent number of variance 1 that runs share, shape (1, r) [N, N*m].

    By name and source: the same numbers are wrong in all parts of a record, and in components with the same source.
    """
    found: dict[tuple[str, str], Array] = {}
    for part in one.contributions:
        own = part.on_its_clock(weights[None]) if isinstance(part, Divided) else weights[None]
        for first, piece in _pieces(part):
            if isinstance(piece, Systematic) and _kind(piece) == "common" and piece.slopes.size:
                here = own[:, first : first + piece.slopes.shape[0]] @ piece.slopes @ piece.numbers
                key = piece.name, piece.source
                found[key] = added(found.get(key, np.zeros((1, 0))), here)
    return found


def _alike(dynamics: BalanceDynamics, one: str, other: str) -> int | None:
    """How many of the numbers that the dynamics are made of two components share; None for all.

    Coupled ones share all, and others the first, that of the mass, where it is one that was weighed once.
    """
    if other in dynamics.block_of(one).components:
        return None
    return int(isinstance(dynamics, IndependentDynamics) and dynamics.have_one_mass(one, other))


def _covariance(
    one: Mapping[tuple[str, str], Array], other: Mapping[tuple[str, str], Array], *, of_dynamics: int | None
) -> float:
    """Covariance of two means by what both have in common; of the dynamics so many numbers are, or all."""
    total = 0.0
    for key, own in one.items():
        theirs = other.get(key)
        if theirs is not None:
            width = min(own.shape[1], theirs.shape[1])
            if key[1] == DYNAMICS and of_dynamics is not None:
                width = min(width, of_dynamics)
            total += float((own[:, :width] @ theirs[:, :width].T)[0, 0])
    return total


def _of_matrix(loads: Loads, names: Sequence[str], present: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
    """Covariance of the mean loads by the matrix with the bridges' gains, by zeros and by tares, shape (c, c) each."""
    place = [loads.components.index(name) for name in names]
    turn = loads.transform[place]
    known = present & np.isfinite(loads.native).all(axis=1)
    native = loads.native[known].mean(axis=0)
    matrix = turn @ loads.balance.load_covariance(native[None])[0] @ turn.T
    slope = turn @ loads.balance.sensitivity(native[None])[0]
    zero = slope @ np.diag(loads.of_zero) @ slope.T
    tare = loads.of_tare[np.ix_(place, place)]
    # what is left of zeros and gains, whose parts are not told apart: independent of component to component
    apart = loads.apart[known] if len(loads.apart) > 1 else loads.apart
    rest = np.maximum(apart.mean(axis=0)[place] - np.diag(zero) - np.diag(tare), 0.0)
    return np.asarray(matrix + np.diag(rest)), np.asarray(zero), np.asarray(tare)


def _correlated(run: Array, loads: Loads, names: Sequence[str]) -> Array:
    """Noise of the means, correlated as that of the readings is: slow changes pass the balance as they are."""
    place = [loads.components.index(name) for name in names]
    noise = loads.noise_covariance[np.ix_(place, place)]
    size = np.sqrt(np.maximum(np.diag(noise), 0.0))
    if not size.all():
        return run
    deviation = np.sqrt(np.maximum(np.diag(run), 0.0))
    return np.asarray(noise / np.outer(size, size) * np.outer(deviation, deviation))


def _scatter(parts: Sequence[ComponentForce], present: NDArray[np.bool_]) -> tuple[Array, float]:
    """Covariance of the means by what the force fluctuates in so short a record, and its degrees of freedom."""
    count = len(parts)
    if not present.all():
        spans = np.flatnonzero(np.diff(np.concatenate(([False], present, [False])).astype(np.int8))).reshape(-1, 2)
        first, last = spans[np.argmax(spans[:, 1] - spans[:, 0])]
    else:
        first, last = 0, present.size
    span = slice(int(first), int(last))
    share = (last - first) / max(np.count_nonzero(present), 1)
    deviations, freedoms, lines = [], [], []
    for part in parts:
        try:
            found = regress(part, {"mean": 1.0}, span=span)
        except FitError:  # too short to show how it fluctuates
            return np.zeros((count, count)), CERTAIN
        variance = float(found.scatter[0, 0])
        deviations.append(np.sqrt(variance * share))
        whole = float(found.measured[0, 0]) + variance
        # the degrees of freedom of the scatter alone, from those of all
        ratio = variance / whole if whole > 0 else 1.0
        freedoms.append(float(found.degrees_of_freedom[0]) * max(ratio, 1e-9) ** 2)
        lines.append(np.fft.rfft(found.residual * np.hanning(found.residual.size))[1 : TAPERS + 1])
    spectra = np.array(lines)
    cross = np.real(spectra @ spectra.conj().T)
    size = np.sqrt(np.maximum(np.diag(cross), np.finfo(float).tiny))
    alike = cross / np.outer(size, size)
    np.fill_diagonal(alike, 1.0)
    deviation = np.array(deviations)
    return np.asarray(alike * np.outer(deviation, deviation)), min(freedoms, default=CERTAIN)
