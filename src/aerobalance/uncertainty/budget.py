"""Uncertainty budget of a force: of its mean, rms, peaks and spectrum, and what to improve first.

Uncertainty is propagated to first order [JCGM100]_: a systematic error does not average out along the record, noise
does, by its spectrum. Rms and spectrum are corrected for the noise of the estimate: the power that the smoother has
taken out of the force is added, and the power that noise has added to a direct inverse is subtracted.

References
----------
.. [JCGM100] JCGM 100:2008, "Evaluation of measurement data - Guide to the expression of uncertainty in measurement".
.. [Welch1967] P. D. Welch, "The use of fast Fourier transform for the estimation of power spectra", IEEE Trans. Audio
   Electroacoust. 15 (1967) 70.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aerobalance.estimation.error_sources import undivided
from aerobalance.estimation.force_smoother import HIDDEN
from aerobalance.estimation.result import ComponentForce, ForceSummary
from aerobalance.estimation.sums import ForceSums, Key, SpectrumSums, segment_length
from aerobalance.estimation.unread_ends import UNREAD
from aerobalance.recording.blas_threads import one_blas_thread
from aerobalance.recording.channel import Array
from aerobalance.recording.doubts import DOUBTED
from aerobalance.recording.errors import argument, not_as_given


@dataclass(frozen=True, slots=True)
class BudgetSettings:
    """Thresholds of a budget.

    Attributes
    ----------
    overlap_loss
        Variance of an average over half-overlapping Hann segments over that of independent ones [Welch1967]_.
    rounding
        Uncertainty over that of a sample below which it is an error of rounding.
    """

    overlap_loss: float = 19 / 18
    rounding: float = 1e-12


SETTINGS: Final = BudgetSettings()
"""Thresholds that are used."""


REMEDIES: Final[Mapping[str, str]] = {
    "noise of the readings": "a quieter load channel (more excitation, a better amplifier, shielding)",
    "noise of the ground motion": "a quieter accelerometer or inclinometer",
    HIDDEN: "a record without gaps",
    "what the model does not explain": "a model that holds there: identify again, with more modes",
    "size and instant of steps": "a longer record on both sides of the steps",
    "size and frequency of steady tones": "a longer record",
    "harmonics of the load that noise hides": "a longer record, or less noise",
    "which side of a step a sample is on": "a higher sampling rate",
    "mass, stiffness, damping, delay": "a better identification: more or longer releases, a mass weighed better",
    "accelerometer gain": "a calibration of the accelerometer",
    "accelerometer zero": "a zero of the accelerometer read before the run",
    "pitch zero": "a zero of the inclinometer checked against a level",
    "pitch gain": "a calibration of the inclinometer",
    "gravity": "the local gravity, from a survey",
    "balance matrix, zeros and tares": "a better static calibration (calibrate "
    f"{argument('reading_noise')}, where that of its readings is known), and zeros read close to the run",
    "curvature of the balance matrix, ringing": "a static calibration with more points, under loads combined",
    "force below detection": "a quieter load channel or a longer record: so much could fluctuate unseen in the noise",
    "dynamics that the record leaves open": "dynamics identified anew, or a record in which the balance rings",
    UNREAD: "readings from the record's beginning to its end",
    "ends of the record": "a record that begins and ends at rest",
}
"""What makes each contribution smaller."""


@dataclass(frozen=True, slots=True)
class Scalar:
    """One number that sums up a force.

    Attributes
    ----------
    name
        Which: mean, rms_about_mean, largest or least.
    value
        The number [N].
    u
        Its standard uncertainty [N].
    parts
        What each contribution adds to it, by name [N].
    by_source
        The same by name and source [N].
    """

    name: str
    value: float
    u: float
    parts: Mapping[str, float]
    by_source: Mapping[Key, float]

    @classmethod
    def of(cls, name: str, value: float, variances: Mapping[Key, float], *, slope: float = 1.0) -> Scalar:
        """Return a number; the variances by name and source are of something that it changes with by a slope."""
        together: dict[str, float] = {}
        for (part, _), variance in variances.items():
            together[part] = together.get(part, 0.0) + variance
        return cls(
            name,
            value,
            slope * float(np.sqrt(sum(variances.values()))),
            {part: slope * float(np.sqrt(variance)) for part, variance in together.items()},
            {key: slope * float(np.sqrt(variance)) for key, variance in variances.items()},
        )


def scalars(estimate: ComponentForce | ForceSummary) -> tuple[Scalar, ...]:
    """Return mean, rms about it, largest and least value of a force, with their standard uncertainties [N, N*m].

    Largest and least are the force at the instants where the estimate is largest and least.

    Parameters
    ----------
    estimate
        The force along one component, or what sums it up.
    """
    return _scalars(_sums_of(estimate))


def beyond_its_extremes(found: Mapping[str, float], unit: str) -> str:
    """Say why a force has a larger rms about its mean than its estimate's extremes; an empty string where it has not.

    Parameters
    ----------
    found
        The numbers of `scalars` by name, and ``uncertainty_rms``, the rms of the standard uncertainty of a sample.
    unit
        Their unit.
    """
    rms, mean = found["rms_about_mean"], found["mean"]
    farthest = max(found["largest"] - mean, mean - found["least"])
    if rms <= farthest:
        return ""
    u = found["uncertainty_rms"]
    return (
        f"the rms about the mean, {rms:.3g} {unit}, is more than the largest and the least value are from the mean, "
        f"{farthest:.2g} {unit}, as these are of the estimate; the rms is that of the force, which lies about its "
        f"estimate with the uncertainty of a sample, {u:.3g} {unit}: so large may a force be that does not show"
    )


def _sums_of(estimate: ComponentForce | ForceSummary) -> ForceSums:
    """Sums over the samples of a force."""
    if isinstance(estimate, ForceSummary):
        return estimate.sums
    if estimate.summary is not None:
        return estimate.summary.sums
    sums = ForceSums(estimate.learned is not None)
    sums.add(estimate.values, estimate.uncertainty, undivided(estimate.contributions))
    return sums


def _spectrum_sums_of(estimate: ComponentForce | ForceSummary) -> SpectrumSums:
    """Sums over segments of the spectrum of a force."""
    if isinstance(estimate, ForceSummary):
        return estimate.spectrum
    if estimate.summary is not None:
        return estimate.summary.spectrum
    sums = SpectrumSums(segment_length(estimate.values.size))
    sums.add(estimate.values, undivided(estimate.contributions))
    return sums


def _scalars(sums: ForceSums) -> tuple[Scalar, ...]:
    if sums.largest is None or sums.least is None:
        raise AssertionError
    count, shift = sums.samples, sums.total / sums.samples
    of_mean = {key: row.variance_of(np.array([1 / count, 0.0])) for key, row in sums.rows.items()}
    found = [Scalar.of("mean", sums.level + shift, of_mean), _rms(sums)]
    for name, end in (("largest", sums.largest), ("least", sums.least)):
        one = Scalar.of(name, end.value, {key: end.parts.get(key, 0.0) ** 2 for key in sums.rows})
        found.append(replace(one, u=end.u))
    return tuple(found)


def noise_power(estimate: ComponentForce | ForceSummary) -> float:
    """Return the mean square of the noise of a force about its mean [N^2]."""
    return _noise_power(_sums_of(estimate))


def _noise_power(sums: ForceSums) -> float:
    count = sums.samples
    rows = [row for row in sums.rows.values() if row.is_noise]
    return sum(row.square / count - row.variance_of(np.array([1 / count, 0.0])) for row in rows)


def _rms(sums: ForceSums) -> Scalar:
    """Return the rms about the mean: first order in the errors, and second order in noise, whose square has a mean."""
    count, shift = sums.samples, sums.total / sums.samples
    sign = 1 if sums.smoothed else -1
    value = float(np.sqrt(max(sums.square / count - shift**2 + sign * _noise_power(sums), 0.0)))
    weights = np.array([-shift, 1.0]) * 2 / count
    variances = {
        key: row.variance_of(weights) + (2 * row.fourth / count**2 if row.is_noise else 0.0)
        for key, row in sums.rows.items()
    }
    of_square = float(np.sqrt(sum(variances.values())))
    # u(r) = u(r^2) / 2r; where r drowns in its uncertainty, the root of the uncertainty of its square
    slope = 1 / (2 * max(value, np.sqrt(of_square) / 2)) if of_square else 0.0
    return Scalar.of("rms_about_mean", value, variances, slope=slope)


@dataclass(frozen=True, slots=True, eq=False)
class ForceSpectrum:
    """One-sided power spectral density of a force.

    Attributes
    ----------
    frequency
        Frequencies, shape (m,) [Hz].
    density
        Density of the force [N^2/Hz], shape (m,).
    scatter
        Its standard uncertainty as an estimate from a record of this length, if the force is a stationary process.
    uncertainty
        Its standard uncertainty because the force is uncertain.
    """

    frequency: Array
    density: Array
    scatter: Array
    uncertainty: Array


def spectrum(estimate: ComponentForce | ForceSummary, *, rate: float) -> ForceSpectrum:
    """Return the one-sided power spectral density of a force by [Welch1967]_, Hann windows that overlap by half.

    Parameters
    ----------
    estimate
        The force.
    rate
        Sampling rate [Hz].
    """
    sums, whole_record = _spectrum_sums_of(estimate), _sums_of(estimate)
    rate = rate / sums.every
    samples, smoothed, length = whole_record.samples, whole_record.smoothed, sums.length
    density, noise = sums.density / sums.segments / rate, sums.noise / samples / rate
    count = max(2 * (samples // length) - 1, 1) / (1.0 if samples < 2 * length else SETTINGS.overlap_loss)
    scale = (sums.segments * rate) ** 2
    squares = sums.variance + sum((np.sum(one**2, axis=1) for one in sums.common.values()), np.zeros(density.size))
    variance = np.maximum(squares, 0.0) / scale + (2 * density * noise + noise**2) / count
    whole = density + noise if smoothed else np.maximum(density - noise, 0.0)
    frequency = np.asarray(np.arange(density.size) * (rate / length), dtype=np.float64)
    return ForceSpectrum(frequency, whole, whole / np.sqrt(count), np.asarray(np.sqrt(variance)))


@dataclass(frozen=True, slots=True)
class BandLevel:
    """Rms of a force in a band of frequencies.

    Attributes
    ----------
    low, high
        The band [Hz].
    rms, u
        Rms [N, N*m] and its standard uncertainty as the force was in this record, errors of all frequencies taken as
        one; None beyond half of the sampling rate.
    """

    low: float
    high: float
    rms: float | None
    u: float | None


def band_levels(part: ComponentForce, bands: Sequence[tuple[float, float]], *, rate: float) -> tuple[BandLevel, ...]:
    """Return the rms of a force in bands of frequencies [N, N*m].

    Parameters
    ----------
    part
        The force.
    bands
        Lower and upper frequency of each [Hz].
    rate
        Sampling rate [Hz].
    """
    found = spectrum(part, rate=rate)
    step = float(found.frequency[1]) if found.frequency.size > 1 else 0.0
    levels = []
    for low, high in bands:
        if not step or low >= rate / 2:
            levels.append(BandLevel(low, high, None, None))
            continue
        # each ordinate stands for the frequencies half a step about it
        share = _overlap(found.frequency, step, low, high)
        power = float(found.density @ share)
        u_power = float(found.uncertainty @ share)
        rms = float(np.sqrt(power))
        u = u_power / (2 * max(rms, float(np.sqrt(u_power)) / 2)) if u_power else 0.0
        levels.append(BandLevel(low, high, rms, u))
    return tuple(levels)


def _overlap(frequency: Array, step: float, low: float, high: float) -> Array:
    """Widths of a band that belong to the ordinates [Hz], shape (m,)."""
    upper, lower = np.minimum(frequency + step / 2, high), np.maximum(frequency - step / 2, max(low, 0.0))
    return np.asarray(np.maximum(upper - lower, 0.0))


@dataclass(frozen=True, slots=True)
class BudgetLine:
    """One line of an uncertainty budget.

    Attributes
    ----------
    name, source
        The contribution, and the channel or file that it comes from.
    rms
        Root mean square over the record [N].
    share
        Share of the variance [1].
    if_halved
        Rms of the whole uncertainty if the cause were half as large [N].
    scalars
        What it adds to the standard uncertainty of mean, rms_about_mean, largest and least [N].
    assumed
        Whether it is no contribution, but what would come of an assumption that the record cannot show to be wrong.
    """

    name: str
    source: str
    rms: float
    share: float
    if_halved: float
    scalars: Mapping[str, float]
    assumed: bool = False

    def __repr__(self) -> str:
        part = ", not counted" if self.assumed else f", {100 * self.share:.2g} % of the variance"
        return f"{self.name} ({self.source}): {self.rms:.2g} rms{part}"


@one_blas_thread()
def budget(force: Mapping[str, ComponentForce]) -> dict[str, tuple[BudgetLine, ...]]:
    """Uncertainty budget of a force [N, N*m] by component, the largest contribution first, what is assumed last.

    Parameters
    ----------
    force
        The forces, as `aerobalance.estimate_force` gives them.
    """
    if not hasattr(force, "items"):
        raise not_as_given("the forces of all components are", force, "`estimate_force` returns them")
    return {name: (*component_budget(part), *_assumed(part)) for name, part in force.items()}


def _assumed(estimate: ComponentForce) -> Iterator[BudgetLine]:
    """What is assumed: it has no share of the variance."""
    whole = float(np.linalg.norm(list(estimate.budget.values())))
    for one in estimate.assumed:
        yield BudgetLine(f"assumed: {one.kind}", one.text, one.effect, 0.0, whole, {}, assumed=True)


def component_budget(estimate: ComponentForce | ForceSummary) -> tuple[BudgetLine, ...]:
    """Uncertainty budget of the force along one component [N], the largest contribution first."""
    sums = _sums_of(estimate)
    found = _scalars(sums)
    squares = {key: row.square / sums.samples for key, row in sums.rows.items()}
    whole = sum(squares.values())
    rows = []
    for key, row in sums.rows.items():
        square = squares[key]
        left = max(whole - square + row.left / sums.samples, 0.0)
        rows.append(
            BudgetLine(
                name=key[0],
                source=key[1],
                rms=float(np.sqrt(square)),
                share=square / whole if whole else 0.0,
                if_halved=float(np.sqrt(left)),
                scalars={scalar.name: _not_rounding(scalar.by_source[key], square) for scalar in found},
            )
        )
    return tuple(sorted(rows, key=lambda row: -row.rms))


def _not_rounding(u: float, square: float) -> float:
    """Return an uncertainty, or zero where it is an error of rounding."""
    return u if u > SETTINGS.rounding * np.sqrt(square) else 0.0


def advice(
    estimate: ComponentForce | ForceSummary, *, unit: str = "N", sources: Mapping[str, str] | None = None
) -> str:
    """Return one sentence on what to improve first, and what it would bring.

    Parameters
    ----------
    estimate
        The force.
    unit
        Unit of the force.
    sources
        What to call the sources of its contributions, where they have other names.
    """
    rows = component_budget(estimate)
    names = {row.source: row.source for row in rows} | dict(sources or {})
    whole = float(np.linalg.norm([row.rms for row in rows]))
    if not whole:
        return "no contribution to the uncertainty is known"
    first = rows[0]
    if first.name.startswith(DOUBTED):
        return (
            f"settle the doubt first: {first.name.removeprefix(DOUBTED)} ({names[first.source]}) makes "
            f"{100 * first.share:.0f} % of the variance"
        )
    text = (
        f"improve first {first.name} ({names[first.source]}), {100 * first.share:.0f} % of the variance: halving it "
        f"would take the uncertainty from {whole:.3g} to {first.if_halved:.3g} {unit} rms"
    )
    remedy = REMEDIES.get(first.name)
    helps = f"; what helps is {remedy}" if remedy else ""
    mean = max(rows, key=lambda row: row.scalars["mean"])
    of_mean = float(np.linalg.norm([row.scalars["mean"] for row in rows]))
    other = ""
    if mean.name != first.name and mean.scalars["mean"] ** 2 > of_mean**2 / 2:
        other = f"; for the mean alone, {mean.name} ({names[mean.source]}) comes first"
    return f"{text}{helps}{other}"
