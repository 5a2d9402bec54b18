"""The force applied along one component: every sample with its uncertainty and where that is from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from aerobalance.estimation.correlated_noise import SharedNoise
from aerobalance.estimation.error_sources import Contribution, Noise, Systematic
from aerobalance.estimation.observation import SpectralPrior
from aerobalance.estimation.spectra.lines import Line
from aerobalance.estimation.steps import Step
from aerobalance.estimation.sums import ForceSums, SpectrumSums
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import Assumption, Doubt, Size

SHOWN: Final = 5
"""Steps that a force names when it is shown."""


@dataclass(frozen=True, slots=True, eq=False)
class ForceSummary:
    """What is left of the force along one component when its samples are gone.

    Attributes
    ----------
    component, method, noise, bandwidth, noise_gain, steps, hum, assumptions, doubts, assumed, tones
        As in `ComponentForce`.
    sums, spectrum
        Sums over its samples.
    mean_load
        Mean of the balance load over the readings there are [N]; NaN where none was kept.
    mean_weight
        Mean weight of the moving mass along the component, by the angles of the record [N]; NaN where it has none.
    """

    component: str
    method: str
    noise: float
    bandwidth: float
    noise_gain: float
    steps: tuple[Step, ...]
    hum: tuple[Line, ...]
    assumptions: tuple[str, ...]
    sums: ForceSums
    spectrum: SpectrumSums
    doubts: tuple[Doubt, ...] = ()
    assumed: tuple[Assumption, ...] = ()
    tones: tuple[Line, ...] = ()
    mean_load: float = np.nan
    mean_weight: float = np.nan

    @property
    def rms_uncertainty(self) -> float:
        """Root mean square of the standard uncertainty of the samples [N]."""
        return float(np.sqrt(self.sums.variance / self.sums.samples))

    @property
    def size(self) -> Size:
        """How large the force is."""
        sums = self.sums
        shift = sums.total / sums.samples
        rms = float(np.sqrt(max(sums.square / sums.samples - shift**2, 0.0)))
        return Size(self.rms_uncertainty, rms, sums.level + shift)

    @property
    def budget(self) -> dict[str, float]:
        """Root mean square of each contribution to the uncertainty [N]."""
        squares: dict[str, float] = {}
        for (name, _), row in self.sums.rows.items():
            squares[name] = squares.get(name, 0.0) + row.square
        return {name: float(np.sqrt(square / self.sums.samples)) for name, square in squares.items()}


@dataclass(frozen=True, slots=True, eq=False)
class ComponentForce:
    """The force applied along one component, and how it was found.

    Attributes
    ----------
    component
        Which component.
    values
        Applied force, shape (n,) [N].
    uncertainty
        Standard uncertainty of every sample, shape (n,) [N].
    method
        Words for the method and its settings.
    noise
        Standard uncertainty of a reading of the load [N].
    bandwidth
        Frequency up to which the force is resolved [Hz].
    noise_gain
        Noise of the force over noise of the reading [1].
    steps
        Sudden changes of the force that were found.
    hum
        Steady lines of the reading that were taken for hum and not for force.
    assumptions
        What was taken as zero because the recording does not have it.
    budget
        Root mean square of each contribution to the uncertainty [N].
    contributions
        The contributions themselves.
    learned
        Prior of the force and noise that the smoother took; None for the other methods.
    shared
        Noise that other components show and that was taken off the readings; None where none was.
    summary
        What sums up the force, where it was worked out in parts; None where the contributions tell it.
    doubts
        What the record says against the force.
    assumed
        What the record cannot show and is not in the uncertainty, with what it would do to the force.
    found_motion
        What gaps hid of the ground's motion and its channels lack, as the load shows it, shape (n,) [m/s^2]; None
        where that was not looked for.
    tones
        Steady tones of the force, with their sizes in the force.
    bends
        Instants of sudden changes of the force's slope, from the first sample on [s].
    """

    component: str
    values: Array
    uncertainty: Array
    method: str
    noise: float
    bandwidth: float
    noise_gain: float
    steps: tuple[Step, ...] = ()
    hum: tuple[Line, ...] = ()
    assumptions: tuple[str, ...] = ()
    budget: dict[str, float] = field(default_factory=dict)
    contributions: tuple[Contribution, ...] = ()
    learned: SpectralPrior | None = None
    shared: SharedNoise | None = None
    summary: ForceSummary | None = None
    doubts: tuple[Doubt, ...] = ()
    assumed: tuple[Assumption, ...] = ()
    found_motion: Array | None = None
    tones: tuple[Line, ...] = ()
    bends: tuple[float, ...] = ()

    def __repr__(self) -> str:
        unit, u = si_unit(self.component), float(np.sqrt(np.nanmean(self.uncertainty**2)))
        mean, deviation = np.nanmean(self.values), np.nanstd(self.values)
        size = f"mean {mean:.6g}, rms about it {deviation:.6g}, u of a sample {u:.2g} {unit}"
        rows = [f"force {self.component}, {self.values.size} samples: {size}", self.method]
        rows += [f"step of {one.height:.6g} {unit} at {one.instant:.6g} s" for one in self.steps[:SHOWN]]
        return "\n  ".join(rows + [f"and {len(self.steps) - SHOWN} steps more"] * (len(self.steps) > SHOWN))


def with_balance(
    estimate: ComponentForce, static: Array, *, curvature: tuple[float, Array] = (0.0, np.ones(1))
) -> ComponentForce:
    """Add the uncertainty of the balance matrix, its zeros and tares to an estimate.

    The error of a matrix is a function of the load: to first order a gain and an offset. Both go through Eq. (17) of
    [Gorbushin2020]_ unchanged, as it is linear, so the error of the force is that of a static load of its size. What
    is curved in it comes on top where the load changes (`aerobalance.balance.calibration_nonlinearity`).

    Parameters
    ----------
    estimate
        The force from loads that were taken as exact but for their noise.
    static
        Standard uncertainty of a static load of the force's size, shape (n,) [N]; NaN counts as the largest.
    curvature
        Standard uncertainty from the matrix's curvature under loads that change [N], and the spectrum of that error
        as `aerobalance.estimation.error_sources.Noise` takes it.
    """
    known = np.isfinite(static)
    filled = np.where(known, static, np.max(static[known], initial=0.0))
    parts: list[Contribution] = [_gain_and_offset(estimate.values, filled)]
    deviation, spectrum = curvature
    if deviation > 0:
        level = np.full(filled.size, deviation)
        parts.append(Noise("curvature of the balance matrix, ringing", "balance", level, spectrum))
    return replace(
        estimate,
        uncertainty=np.sqrt(estimate.uncertainty**2 + filled**2 + deviation**2),
        budget={
            **estimate.budget,
            parts[0].name: float(np.sqrt(np.mean(filled**2))),
            **{part.name: deviation for part in parts[1:]},
        },
        contributions=(*estimate.contributions, *parts),
    )


def with_doubt(estimate: ComponentForce, doubt: Doubt, *errors: Contribution) -> ComponentForce:
    """Add a doubt to an estimate, and what it does to the force to its uncertainty."""
    return replace(with_errors(estimate, *errors), doubts=(*estimate.doubts, doubt))


def with_errors(estimate: ComponentForce, *errors: Contribution) -> ComponentForce:
    """Add contributions to the uncertainty of an estimate."""
    whole = np.sqrt(estimate.uncertainty**2 + sum(error.deviation**2 for error in errors))
    return replace(
        estimate,
        uncertainty=np.asarray(whole),
        budget=budget_of(errors, estimate.budget),
        contributions=(*estimate.contributions, *errors),
    )


def budget_of(errors: Sequence[Contribution], before: Mapping[str, float] | None = None) -> dict[str, float]:
    """Return the root mean square of contributions by name [N, N*m], those before included.

    Two sensors of one kind have contributions of one name, whose squares are added.
    """
    found = {} if before is None else dict(before)
    for error in errors:
        found[error.name] = float(np.hypot(found.get(error.name, 0.0), np.sqrt(np.mean(error.deviation**2))))
    return found


def with_few(estimate: ComponentForce) -> ComponentForce:
    """The same with what holds along the record as the few independent numbers that show in the force."""
    parts = tuple(part.few if isinstance(part, Systematic) else part for part in estimate.contributions)
    return replace(estimate, contributions=parts)


def _gain_and_offset(values: Array, static: Array) -> Systematic:
    """The error of a matrix as a gain and an offset: its variance is then a parabola over the force."""
    size = float(np.max(np.abs(values), initial=0.0)) or 1.0
    share = values / size
    terms = np.column_stack([np.ones(share.size), 2 * share, share**2])
    offset, both, gain = np.linalg.lstsq(terms, static**2, rcond=1e-9)[0]
    level, vectors = np.linalg.eigh([[offset, both], [both, gain]])
    covariance = (vectors * np.maximum(level, 0.0)) @ vectors.T
    slopes = np.column_stack([np.ones(share.size), share])
    found = float(np.mean(np.sum((slopes @ covariance) * slopes, axis=1)))
    covariance *= float(np.mean(static**2)) / found if found > 0 else 0.0
    names = ("offset", f"gain, at {size:.4g}")
    # the offset first, so that all parts of a record share the numbers that it and the gain are made of
    along = np.sqrt(covariance[0, 0])
    across = covariance[0, 1] / along if along > 0 else 0.0
    root = np.array([[along, 0.0], [across, np.sqrt(max(covariance[1, 1] - across**2, 0.0))]])
    return Systematic("balance matrix, zeros and tares", "balance", names, slopes, covariance, root)
