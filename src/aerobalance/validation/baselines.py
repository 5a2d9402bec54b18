"""Other ways from the balance load to the force applied, each a small function with the same signature.

All of them are given what they need at its best: gaps are filled, channels aligned, and the known force of the
ground's motion is taken off where Eq. (17) of [Gorbushin2020]_ does it. None is handicapped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import butter, filtfilt, iirnotch, sosfiltfilt

from aerobalance.dynamics.modal import ModalModel
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.direct import band_limited as band_limited_of
from aerobalance.estimation.direct import central_differences as central_differences_of
from aerobalance.estimation.force import estimate_force
from aerobalance.estimation.force_record import force_record
from aerobalance.estimation.result import ComponentForce
from aerobalance.motion.single_axis import GroundMotion
from aerobalance.recording.channel import Array
from aerobalance.recording.components import STANDARD_GRAVITY, driving_channel
from aerobalance.recording.errors import FitError
from aerobalance.recording.gravity import gravity_share
from aerobalance.recording.progress import PROGRESS
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import fractional_delay, interpolate_gaps_linearly
from aerobalance.recording.sensors import angles_of, corrected
from aerobalance.validation.fir_inverse import ORDER, MeasuredResponse, fir_inverse, fit_frequencies, undo
from aerobalance.validation.scores import Truth

LOW_PASS_ORDER: Final = 4
"""Order of the Butterworth low-pass; forward and backward, so that its gain is squared and its phase zero."""

NOTCH_QUALITY: Final = 2.0
"""Natural frequency over the notch's width at 3 dB."""

HIGHEST_CORNER: Final = 0.49
"""Highest corner of a filter over the sampling rate; a digital filter has none at half of it."""

THIS: Final = "this estimator"
"""Name of the program's own estimate among the baseline methods."""

FEWEST_PERIODS: Final = 10
"""Periods that the record must hold of the sine that it is taken for."""


@dataclass(frozen=True, slots=True)
class BaselineSettings:
    """What a baseline method may be told.

    Attributes
    ----------
    gravity
        Local acceleration of gravity [m/s^2].
    tuning
        The method's one tuning number [Hz]; None for its customary setting.
    response
        Measured response of the balance; None for that of the dynamics.
    still
        Whether the ground is taken not to move: what it puts on the reading has been taken off.
    """

    gravity: float = STANDARD_GRAVITY
    tuning: float | None = None
    response: MeasuredResponse | None = None
    still: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class BaselineEstimate:
    """The force as one baseline method has it.

    Attributes
    ----------
    name
        Name of the method.
    values
        Force, shape (n,) [N]; NaN where it could not be run.
    settings
        Its settings, in words.
    note
        Its delay, and what it does at the ends of the record.
    lacking
        Why it could not be run; empty where it was.
    oracle
        Whether its tuning number was chosen with the truth in hand.
    tuning
        Its tuning number [Hz]; NaN where it has none.
    """

    name: str
    values: Array
    settings: str = ""
    note: str = ""
    lacking: str = ""
    oracle: bool = False
    tuning: float = float("nan")

    @property
    def ran(self) -> bool:
        """Whether there is an estimate."""
        return not self.lacking


Estimator = Callable[[Recording, ModalModel, BaselineSettings], BaselineEstimate]

ZERO_PHASE: Final = "no delay; the record is continued by odd reflection at its ends"


def raw_reading(recording: Recording, dynamics: ModalModel, settings: BaselineSettings) -> BaselineEstimate:
    """Take the balance load for the force, less the weight where the pitch is known."""
    load = _load(recording, dynamics)
    weight = _weight(recording, dynamics, settings)
    words = "as read" if weight is None else "as read, less the weight"
    return BaselineEstimate("raw reading", load - (0.0 if weight is None else weight), words, "no delay")


def low_pass(recording: Recording, dynamics: ModalModel, settings: BaselineSettings) -> BaselineEstimate:
    """Zero-phase Butterworth low-pass, customarily at a third of the natural frequency."""
    corner = corner_frequency(recording, settings, dynamics.natural_frequency / 3)
    values = _smoothed(_reading(recording, dynamics, settings), corner, recording.rate)
    return BaselineEstimate("low-pass", values, f"{_butterworth(corner)}", ZERO_PHASE, tuning=corner)


def notch(recording: Recording, dynamics: ModalModel, settings: BaselineSettings) -> BaselineEstimate:
    """Notch at every natural frequency and a low-pass, customarily at twice the first natural frequency."""
    f0, rate = dynamics.natural_frequency, recording.rate
    if f0 >= rate / 2:
        raise FitError(f"the natural frequency of {f0:.4g} Hz is above half the sampling rate")
    corner = corner_frequency(recording, settings, 2 * f0)
    values = _reading(recording, dynamics, settings)
    words = ""
    for frequency in (mode.natural_frequency for mode in dynamics.modes):
        if frequency < rate / 2:
            values = filtfilt(*iirnotch(frequency, NOTCH_QUALITY, fs=rate), values)
            words += f"notch at {frequency:.4g} Hz, {frequency / NOTCH_QUALITY:.3g} Hz wide, "
    words += _butterworth(corner)
    return BaselineEstimate("notch and low-pass", _smoothed(values, corner, rate), words, ZERO_PHASE, tuning=corner)


def accelerometer_correction(
    recording: Recording, dynamics: ModalModel, settings: BaselineSettings
) -> BaselineEstimate:
    """F = AF + M x2'' - M g sin(theta): the inertia of the live end by its own accelerometer, damping left out.

    A dc-coupled accelerometer reads x2'' - g sin(theta), so that the weight is in its reading already.
    """
    balance = _balance(dynamics)
    name = driving_channel("live", balance.component, recording)
    channel = recording.channel(name)
    load = recording.channel(dynamics.component)
    lag = balance.delay + load.delay - channel.delay
    acceleration = interpolate_gaps_linearly(channel.values)
    acceleration = fractional_delay(acceleration, delay=lag, interval=1 / recording.rate)
    values = interpolate_gaps_linearly(load.values) + balance.mass * acceleration
    weight = None if channel.coupling == "dc" else _weight(recording, dynamics, settings)
    words = f"M = {balance.mass:.5g} kg, {name} {channel.coupling}"
    delay = f"no delay{_one_mode(dynamics, 'the live end moves as one mass')}"
    if weight is not None:
        values = values - weight
    elif channel.coupling != "dc":
        words += ", no pitch"
    if settings.tuning is None:
        return BaselineEstimate("accelerometer correction", values, f"{words}, no filter", delay)
    corner = corner_frequency(recording, settings, settings.tuning)
    return BaselineEstimate(
        "accelerometer correction", _smoothed(values, corner, recording.rate), f"{words}, {_butterworth(corner)}",
        f"{ZERO_PHASE}{_one_mode(dynamics, 'the live end moves as one mass')}", tuning=corner,
    )  # fmt: skip


def correction_factor(recording: Recording, dynamics: ModalModel, settings: BaselineSettings) -> BaselineEstimate:
    """Divide what departs from the mean by |G(f)| at one frequency, customarily the record's strongest."""
    load, known = _load(recording, dynamics), _known(recording, dynamics, settings)
    frequency = dominant_frequency(load, recording.rate) if settings.tuning is None else settings.tuning
    gain = float(np.abs(dynamics.response(frequency)))
    mean = float(np.mean(load))
    return BaselineEstimate(
        "correction factor", mean + (load - mean) / gain - known, f"1/|G| = {1 / gain:.4g} at {frequency:.5g} Hz",
        "the phase is left as it is", tuning=frequency,
    )  # fmt: skip


def factor_and_phase(recording: Recording, dynamics: ModalModel, settings: BaselineSettings) -> BaselineEstimate:
    """Apply the correction factor, and undo the phase at the same frequency by a shift in time."""
    plain = correction_factor(recording, dynamics, settings)
    known = _known(recording, dynamics, settings)
    lag = float(-np.angle(dynamics.response(plain.tuning))) / (2 * np.pi * plain.tuning)
    return replace(
        plain,
        name="correction factor and phase",
        values=fractional_delay(plain.values + known, delay=-lag, interval=1 / recording.rate) - known,
        settings=f"{plain.settings}, {1e3 * lag:.4g} ms earlier",
        note=f"the last {1e3 * lag:.3g} ms repeat the last reading",
    )


def fir_deconvolution(recording: Recording, dynamics: ModalModel, settings: BaselineSettings) -> BaselineEstimate:
    """Black-box inverse of a measured step or impulse response, and a low-pass, as PyDynamic does it."""
    rate = recording.rate
    frequency = fit_frequencies(rate)
    response = settings.response or MeasuredResponse(
        frequency, dynamics.response(frequency), "the model's own response"
    )
    load = _load(recording, dynamics)
    if load.size <= 4 * ORDER:
        raise FitError(f"{load.size} readings are too few for a filter of {ORDER + 1} coefficients")
    coefficients = _design(response, rate)
    corner = corner_frequency(recording, settings, 2 * dynamics.natural_frequency)
    return BaselineEstimate(
        "FIR deconvolution",
        _smoothed(undo(load, coefficients) - _known(recording, dynamics, settings), corner, rate),
        f"{ORDER + 1} coefficients from {response.source}, {_butterworth(corner)}",
        f"delay of {ORDER // 2} samples taken out; as many at each end rest on a continuation",
        tuning=corner,
    )


def model_response(dynamics: ModalModel, rate: float) -> MeasuredResponse:
    """Response of the dynamics, where none was measured."""
    frequency = fit_frequencies(rate)
    return MeasuredResponse(frequency, dynamics.response(frequency), "the model's own response, as no step was given")


@lru_cache(maxsize=4)
def _design(response: MeasuredResponse, rate: float) -> Array:
    """Filter of one response; the search for the best corner asks for it again and again."""
    return fir_inverse(response, rate=rate)


def central_differences(recording: Recording, dynamics: ModalModel, settings: BaselineSettings) -> BaselineEstimate:
    """Eq. (17) of [Gorbushin2020]_ with the paper's derivatives."""
    estimate = _inverse(recording, dynamics, settings, bandwidth=None)
    left = _one_mode(dynamics, "M, b and k are those of the first")
    return BaselineEstimate(
        "central differences", estimate.values, estimate.method, f"no delay; first and last sample poor{left}"
    )


def band_limited(recording: Recording, dynamics: ModalModel, settings: BaselineSettings) -> BaselineEstimate:
    """Eq. (17) of [Gorbushin2020]_ limited to a band, customarily twice the natural frequency."""
    bandwidth = corner_frequency(recording, settings, 2 * dynamics.natural_frequency)
    estimate = _inverse(recording, dynamics, settings, bandwidth=bandwidth)
    return BaselineEstimate("band-limited inverse", estimate.values, estimate.method, ZERO_PHASE, tuning=bandwidth)


def _inverse(
    recording: Recording, dynamics: ModalModel, settings: BaselineSettings, *, bandwidth: float | None
) -> ComponentForce:
    """A direct inverse; what the record says against the dynamics is not asked, as a baseline method does not."""
    balance = _balance(dynamics)
    record = force_record(without_gaps(recording, balance.component), balance, gravity=settings.gravity)
    one = record.component_records(record.loads)[balance.component]
    return central_differences_of(one) if bandwidth is None else band_limited_of(one, bandwidth)


def this_estimator(recording: Recording, dynamics: ModalModel, settings: BaselineSettings) -> BaselineEstimate:
    """The program's own estimate."""
    estimate = estimate_force(recording, _balance(dynamics), gravity=settings.gravity).only
    return BaselineEstimate(THIS, estimate.values, estimate.method, "no delay; every sample has its uncertainty")


BASELINES: Final[Mapping[str, Estimator]] = {
    "raw reading": raw_reading,
    "low-pass": low_pass,
    "notch and low-pass": notch,
    "accelerometer correction": accelerometer_correction,
    "correction factor": correction_factor,
    "correction factor and phase": factor_and_phase,
    "FIR deconvolution": fir_deconvolution,
    "central differences": central_differences,
    "band-limited inverse": band_limited,
    THIS: this_estimator,
}
"""Every baseline method by its name, the program's own estimate last."""

TUNED: Final = (
    "low-pass",
    "notch and low-pass",
    "accelerometer correction",
    "correction factor",
    "correction factor and phase",
    "FIR deconvolution",
    "band-limited inverse",
)
"""Baseline methods with one tuning number."""


def estimates(
    recording: Recording,
    dynamics: ModalModel,
    *,
    settings: BaselineSettings | None = None,
    truth: Truth | None = None,
    baselines: Mapping[str, Estimator] = BASELINES,
    tuned: Sequence[str] = TUNED,
) -> list[BaselineEstimate]:
    """Run every baseline method on one record; with a truth, those with a tuning number a second time at their best.

    Parameters
    ----------
    recording
        Balance load, and what else is recorded.
    dynamics
        The balance.
    settings
        Gravity and a measured response, where there is one; its tuning number is not used.
    truth
        What was applied; the second setting of a method is the one with the least rms deviation from it.
    baselines, tuned
        The methods by name, and which of them have a tuning number.
    """
    settings = replace(settings or BaselineSettings(), tuning=None)
    recording = replace(corrected(recording), from_outputs=False)  # what is compared are values
    # what is compared are values: without a covariance no method is run again to learn its uncertainty
    dynamics = dynamics.exact
    if settings.response is None:
        settings = replace(settings, response=model_response(dynamics, recording.rate))
    found = []
    for name, baseline in PROGRESS.each(baselines.items(), "method"):
        customary = _attempt(name, baseline, recording, dynamics, settings)
        found.append(customary)
        if truth is not None and customary.ran and name in tuned:
            found.append(_at_its_best(baseline, recording, dynamics, settings, truth=truth))
    return found


def _attempt(
    name: str, baseline: Estimator, recording: Recording, dynamics: ModalModel, settings: BaselineSettings
) -> BaselineEstimate:
    try:
        return baseline(recording, dynamics, settings)
    except (FitError, ValueError) as problem:  # what cannot be run is a row of the table, not the end of it
        nothing = np.full(recording.samples, np.nan)
        return BaselineEstimate(name, nothing, lacking=" ".join(str(problem).split()))


def _at_its_best(
    baseline: Estimator, recording: Recording, dynamics: ModalModel, settings: BaselineSettings, *, truth: Truth
) -> BaselineEstimate:
    """Choose the tuning number on the truth: a search over decades, then within the best step."""

    def miss(exponent: float) -> float:
        return truth.score(baseline(recording, dynamics, replace(settings, tuning=float(np.exp(exponent)))).values).rms

    highest = HIGHEST_CORNER * recording.rate
    lowest = max(min(dynamics.natural_frequency / 30, highest / 10), 2 / recording.duration)
    grid = np.linspace(np.log(lowest), np.log(highest), 24)
    scores = [miss(exponent) for exponent in grid]
    best = int(np.argmin(scores))
    around = float(grid[max(best - 1, 0)]), float(grid[min(best + 1, grid.size - 1)])
    fine = minimize_scalar(miss, bounds=around, method="bounded", options={"maxiter": 16})
    exponent = float(fine.x) if fine.fun < scores[best] else float(grid[best])
    found = baseline(recording, dynamics, replace(settings, tuning=float(np.exp(exponent))))
    return replace(found, oracle=True)


def dominant_frequency(values: Array, rate: float) -> float:
    """Frequency of the strongest sine of ten or more periods [Hz], found between the lines of the spectrum.

    Raises
    ------
    FitError
        The record is too short, or does not change.
    """
    window = np.hanning(values.size)
    tapered = window * (values - np.average(values, weights=window))
    spectrum = np.abs(np.fft.rfft(tapered))
    if not spectrum[FEWEST_PERIODS:].any():
        raise FitError(f"the reading has no sine of {FEWEST_PERIODS} periods or more")
    peak = int(np.argmax(spectrum[FEWEST_PERIODS:])) + FEWEST_PERIODS
    clock = np.arange(values.size) / rate
    step = rate / values.size

    def loss(frequency: float) -> float:
        return -float(np.abs(tapered @ np.exp(-2j * np.pi * frequency * clock)))

    bounds = (peak - 1.0) * step, min(peak + 1.0, values.size / 2) * step
    return float(minimize_scalar(loss, bounds=bounds, method="bounded", options={"xatol": 1e-6 * step}).x)


def _balance(dynamics: ModalModel) -> Dynamics:
    """The balance, for what needs a mass."""
    if not isinstance(dynamics, Dynamics):
        raise FitError(f"the model of {dynamics.component} has no mass")
    return dynamics


def _one_mode(dynamics: ModalModel, why: str) -> str:
    """What a method with one mode leaves out; empty where the balance has no more."""
    further = ", ".join(f"{mode.natural_frequency:.4g}" for mode in dynamics.further_modes)
    return f"; knows one mode only, {why}: {further} Hz left out" if further else ""


def _load(recording: Recording, dynamics: ModalModel) -> Array:
    """Balance load, without gaps."""
    return interpolate_gaps_linearly(recording.channel(dynamics.component).values)


def _known(recording: Recording, dynamics: ModalModel, settings: BaselineSettings) -> Array:
    """Force of the ground's motion and gravity at the load's instants, as in Eq. (17) of [Gorbushin2020]_."""
    if settings.still:
        return np.zeros(recording.samples)
    return _known_force(recording, _balance(dynamics), settings.gravity)


@lru_cache(maxsize=2)
def _known_force(recording: Recording, dynamics: Dynamics, gravity: float) -> Array:
    """Known force of one record; the search for the best corner asks for it again and again."""
    motion = GroundMotion.of(recording, dynamics.component, gravity=gravity)
    lag = dynamics.delay + recording.channel(dynamics.component).delay - motion.delay
    force = fractional_delay(motion.force(dynamics.mass), delay=lag, interval=1 / recording.rate)
    force.setflags(write=False)
    return force


def _reading(recording: Recording, dynamics: ModalModel, settings: BaselineSettings) -> Array:
    """Balance load less the known force: what a filter makes of it is the slow part of the force applied."""
    return _load(recording, dynamics) - _known(recording, dynamics, settings)


def _weight(recording: Recording, dynamics: ModalModel, settings: BaselineSettings) -> Array | None:
    """Weight along the component at the load's instants [N]; None where the pitch is not known."""
    if "pitch" not in recording:
        return None
    pitch, roll = angles_of(recording, delay=recording.channel(dynamics.component).delay)
    return _balance(dynamics).mass * settings.gravity * gravity_share(dynamics.component, pitch=pitch, roll=roll)


def without_gaps(recording: Recording, component: str) -> Recording:
    """Fill the gaps of one component's load by straight lines."""
    channel = recording.channel(component)
    if not channel.missing.any():
        return recording
    channels = {**recording.channels, channel.name: replace(channel, values=interpolate_gaps_linearly(channel.values))}
    return replace(recording, channels=channels)


def corner_frequency(recording: Recording, settings: BaselineSettings, customary: float) -> float:
    """Corner or bandwidth that is set, or else the customary one; below half the sampling rate [Hz]."""
    wanted = customary if settings.tuning is None else settings.tuning
    return float(min(wanted, HIGHEST_CORNER * recording.rate))


def _smoothed(values: Array, corner: float, rate: float) -> Array:
    sections = butter(LOW_PASS_ORDER, corner, fs=rate, output="sos")
    reach = int(min(values.size - 1, max(30, 3 * rate / corner)))  # so that a low corner has settled
    return sosfiltfilt(sections, values, padlen=reach)


def _butterworth(corner: float) -> str:
    return f"Butterworth low-pass of order {LOW_PASS_ORDER} at {corner:.4g} Hz, zero phase"
