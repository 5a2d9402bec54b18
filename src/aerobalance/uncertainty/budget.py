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

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.estimation.error_sources import Noise, Systematic
from aerobalance.estimation.result import ComponentForce
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import argument
from aerobalance.recording.fourier import averaged_spectrum


@dataclass(frozen=True, slots=True)
class BudgetSettings:
    """Sizes and thresholds of the spectrum in a budget.

    Attributes
    ----------
    segments
        Segments of the record, counted without overlap, that a spectrum is averaged over.
    longest_segment
        Samples of one such segment at most.
    overlap_loss
        Variance of an average over half-overlapping Hann segments over that of independent ones [Welch1967]_.
    rounding
        Uncertainty over that of a sample below which it is an error of rounding.
    """

    segments: int = 8
    longest_segment: int = 4096
    overlap_loss: float = 19 / 18
    rounding: float = 1e-12


SETTINGS: Final = BudgetSettings()
"""Thresholds that are used."""


REMEDIES: Final[Mapping[str, str]] = {
    "noise of the readings": "a quieter load channel (more excitation, a better amplifier, shielding)",
    "noise of the ground motion": "a quieter accelerometer or inclinometer",
    "what the model does not explain": "a model that holds there: identify again, with more modes",
    "size and instant of steps": "a longer record on both sides of the steps",
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
        What each contribution adds to it [N].
    """

    name: str
    value: float
    u: float
    parts: Mapping[str, float]


def scalars(estimate: ComponentForce) -> tuple[Scalar, ...]:
    """Return mean, rms about it, largest and least value of a force, with their standard uncertainties [N, N*m].

    Largest and least are the force at the instants where the estimate is largest and least.
    """
    values = estimate.values
    found = [_linear("mean", estimate, np.full(values.size, 1 / values.size)), _rms(estimate)]
    for name, place in (("largest", int(np.argmax(values))), ("least", int(np.argmin(values)))):
        parts = {part.name: float(part.deviation[place]) for part in estimate.contributions}
        found.append(Scalar(name, float(values[place]), float(estimate.uncertainty[place]), parts))
    return tuple(found)


def _linear(name: str, estimate: ComponentForce, weights: Array) -> Scalar:
    parts = {part.name: float(np.sqrt(part.variance_of(weights))) for part in estimate.contributions}
    return Scalar(name, float(weights @ estimate.values), float(np.linalg.norm(list(parts.values()))), parts)


def noise_power(estimate: ComponentForce) -> float:
    """Return the mean square of the noise of a force about its mean [N^2]."""
    noises = [part for part in estimate.contributions if isinstance(part, Noise)]
    weights = np.full(estimate.values.size, 1 / estimate.values.size)
    return sum(float(np.mean(part.deviation**2)) - part.variance_of(weights) for part in noises)


def _rms(estimate: ComponentForce) -> Scalar:
    """Return the rms about the mean: first order in the errors, and second order in noise, whose square has a mean."""
    values = estimate.values
    centred = values - values.mean()
    sign = 1 if estimate.learned is not None else -1
    value = float(np.sqrt(max(float(np.mean(centred**2)) + sign * noise_power(estimate), 0.0)))
    parts = {}
    for part in estimate.contributions:
        variance = part.variance_of(2 * centred / values.size)
        if isinstance(part, Noise):
            variance += 2 * float(np.mean(part.deviation**4) * np.mean(part.spectrum**2)) / values.size
        parts[part.name] = float(np.sqrt(variance))
    of_square = float(np.linalg.norm(list(parts.values())))
    # u(r) = u(r^2) / 2r; where r drowns in its uncertainty, the root of the uncertainty of its square
    slope = 1 / (2 * max(value, np.sqrt(of_square) / 2)) if of_square else 0.0
    return Scalar("rms_about_mean", value, slope * of_square, {name: slope * u for name, u in parts.items()})


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


def spectrum(estimate: ComponentForce, *, rate: float) -> ForceSpectrum:
    """Return the one-sided power spectral density of a force by [Welch1967]_, Hann windows that overlap by half.

    Parameters
    ----------
    estimate
        The force.
    rate
        Sampling rate [Hz].
    """
    values = estimate.values
    length = segment_length(values.size)
    frequency, power = averaged_spectrum(values, rate=rate, length=length)
    density = np.real(power)
    count = max(2 * (values.size // length) - 1, 1) / (1.0 if values.size < 2 * length else SETTINGS.overlap_loss)
    noise, variance = np.zeros(frequency.size), np.zeros(frequency.size)
    for part in estimate.contributions:
        if isinstance(part, Noise):
            noise += part.relative_density(frequency.size) * 2 * float(np.mean(part.deviation**2)) / rate
        elif isinstance(part, Systematic) and part.covariance.any():
            spectra = [averaged_spectrum(values, other=one, rate=rate, length=length)[1] for one in part.slopes.T]
            gradient = 2 * np.real(np.stack(spectra, axis=1))
            variance += np.sum((gradient @ part.covariance) * gradient, axis=1)
    variance = np.maximum(variance, 0.0) + (2 * density * noise + noise**2) / count
    whole = density + noise if estimate.learned is not None else np.maximum(density - noise, 0.0)
    return ForceSpectrum(frequency, whole, whole / np.sqrt(count), np.sqrt(variance))


def segment_length(samples: int) -> int:
    """Return the number of samples of one segment of a spectrum."""
    return min(max(samples // SETTINGS.segments, 32), SETTINGS.longest_segment, samples)


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
    """

    name: str
    source: str
    rms: float
    share: float
    if_halved: float
    scalars: Mapping[str, float]


def budget(force: Mapping[str, ComponentForce]) -> dict[str, tuple[BudgetLine, ...]]:
    """Uncertainty budget of a force [N, N*m] by component, the largest contribution first.

    Parameters
    ----------
    force
        The forces, as `aerobalance.estimate_force` gives them.
    """
    return {name: component_budget(part) for name, part in force.items()}


def component_budget(estimate: ComponentForce) -> tuple[BudgetLine, ...]:
    """Uncertainty budget of the force along one component [N], the largest contribution first."""
    found = scalars(estimate)
    squares = {part.name: float(np.mean(part.deviation**2)) for part in estimate.contributions}
    whole = sum(squares.values())
    rows = []
    for part in estimate.contributions:
        square = squares[part.name]
        left = max(whole - square * (1 - part.halved**2), 0.0)
        rows.append(
            BudgetLine(
                name=part.name,
                source=part.source,
                rms=float(np.sqrt(square)),
                share=square / whole if whole else 0.0,
                if_halved=float(np.sqrt(left)),
                scalars={scalar.name: _not_rounding(scalar.parts[part.name], square) for scalar in found},
            )
        )
    return tuple(sorted(rows, key=lambda row: -row.rms))


def _not_rounding(u: float, square: float) -> float:
    """Return an uncertainty, or zero where it is an error of rounding."""
    return u if u > SETTINGS.rounding * np.sqrt(square) else 0.0


def advice(estimate: ComponentForce, *, unit: str = "N", sources: Mapping[str, str] | None = None) -> str:
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
