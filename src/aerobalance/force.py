r"""From the load felt to the force applied, Eq. (17) of [Gorbushin2020]_.

Three ways, one signature: the optimal estimator (the default), the paper's own derivatives, and the inverse limited to
a band. Each gives every sample a standard uncertainty.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np
from scipy.stats import norm

from aerobalance.components import STANDARD_GRAVITY
from aerobalance.dynamics import PARAMETERS, Dynamics
from aerobalance.motion import GroundMotion, load_from_ground
from aerobalance.noise import white_noise
from aerobalance.prior import Learned, Reading, generalised_least_squares
from aerobalance.problems import DoubtWarning, FitError
from aerobalance.recording import Array, Recording
from aerobalance.smoother import FORCE, LOAD, LOAD_RATE, Filter
from aerobalance.steps import Step, columns_of, find_steps, response_to, shape_of

Method = Literal["smoother", "paper"]

FEWEST_SAMPLES: Final = 32
"""Shortest record that a force is worked out for."""

EXPLAINED_BLOCK: Final = 256
"""Samples over which it is looked whether the readings are explained."""

DIFFERENCE_BANDWIDTH: Final = 0.3183
"""Frequency, over the sampling rate, at which the three-point second difference is 3 dB low."""

BAND_ORDER: Final = 8
"""Order of the zero-phase Butterworth roll-off of the band-limited inverse."""


@dataclass(frozen=True, slots=True, eq=False)
class ForceEstimate:
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
    assumptions
        What was taken as zero because the recording does not have it.
    budget
        Root mean square of each contribution to the uncertainty [N].
    """

    component: str
    values: Array
    uncertainty: Array
    method: str
    noise: float
    bandwidth: float
    noise_gain: float
    steps: tuple[Step, ...] = ()
    assumptions: tuple[str, ...] = ()
    budget: dict[str, float] = field(default_factory=dict)


def reconstruct(
    recording: Recording,
    dynamics: Dynamics,
    *,
    method: Method = "smoother",
    bandwidth: float | None = None,
    gravity: float = STANDARD_GRAVITY,
) -> ForceEstimate:
    """Work out the force applied along one component of a recording, Eq. (17) of [Gorbushin2020]_.

    Parameters
    ----------
    recording
        Load felt, and ground acceleration and pitch where they are recorded.
    dynamics
        Mass, stiffness and damping of the component, with their covariance.
    method
        ``"smoother"``: the optimal estimator. ``"paper"``: three-point central differences.
    bandwidth
        If given, the inverse limited to this band [Hz], zero phase, whichever the method.
    gravity
        Local acceleration of gravity [m/s^2].

    Raises
    ------
    FitError
        The recording has no such component, is too short, or has missing samples that the method cannot bridge.
    """
    load = recording.channel(dynamics.component)
    present = np.isfinite(load.values)
    if np.count_nonzero(present) < FEWEST_SAMPLES:
        raise FitError(
            f"{recording.name}: {np.count_nonzero(present)} readings of {dynamics.component}; "
            f"a force needs at least {FEWEST_SAMPLES}"
        )
    motion = GroundMotion.of(recording, dynamics.component, gravity=gravity)
    job = _Job(recording, dynamics, motion)
    if bandwidth is not None:
        return _band_limited(job, bandwidth)
    if method == "paper":
        return _central_differences(job)
    if method == "smoother":
        return _optimal(job)
    raise ValueError(f"method must be smoother or paper, not {method!r}")


def with_balance(estimate: ForceEstimate, static: Array) -> ForceEstimate:
    """Add the uncertainty of the balance matrix, its zeros and tares to an estimate.

    The error of a matrix is a function of the load: to first order a gain and an offset. Both go through Eq. (17) of
    [Gorbushin2020]_ unchanged, as it is linear, so the error of the force is that of a static load of its size.

    Parameters
    ----------
    estimate
        The force from loads that were taken as exact but for their noise.
    static
        Standard uncertainty of a static load of the force's size, shape (n,) [N]; NaN counts as the largest.
    """
    known = np.isfinite(static)
    filled = np.where(known, static, np.max(static[known], initial=0.0))
    return replace(
        estimate,
        uncertainty=np.hypot(estimate.uncertainty, filled),
        budget={**estimate.budget, "balance matrix, zeros and tares": float(np.sqrt(np.mean(filled**2)))},
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    """A recording with the balance and the ground's motion that go with it."""

    recording: Recording
    dynamics: Dynamics
    motion: GroundMotion

    @property
    def load(self) -> Array:
        return self.recording.channel(self.dynamics.component).values

    @property
    def interval(self) -> float:
        return 1 / self.recording.rate

    @property
    def input_noise(self) -> float:
        """White noise of the ground's motion as a force per sample [N]."""
        return self.dynamics.mass * self.motion.noise

    def parameter_uncertainty(self, load_rate: Array, load_acceleration: Array) -> dict[str, Array]:
        """Standard uncertainty of Eq. (17) of [Gorbushin2020]_ from its coefficients, shape (n,) [N]."""
        d = self.dynamics
        known = self.motion.force(d.mass)
        slopes = {
            "mass": load_acceleration / d.stiffness + self.motion.specific_force,
            "stiffness": -(d.damping * load_rate + d.mass * load_acceleration) / d.stiffness**2,
            "damping": load_rate / d.stiffness,
            "delay": np.gradient(known, self.interval) if known.size > 1 else np.zeros_like(known),
        }
        J = np.column_stack([slopes[name] for name in PARAMETERS])
        return {
            "mass, stiffness, damping, delay": np.sqrt(np.maximum(np.sum((J @ d.covariance) * J, axis=1), 0.0)),
            "accelerometer gain": np.abs(d.mass * self.motion.acceleration) * self.motion.relative_uncertainty,
        }

    def finish(self, values: Array, parts: dict[str, Array], **facts: object) -> ForceEstimate:
        total = np.sqrt(np.sum([part**2 for part in parts.values()], axis=0))
        return ForceEstimate(
            component=self.dynamics.component,
            values=values,
            uncertainty=total,
            assumptions=self.motion.assumptions,
            budget={name: float(np.sqrt(np.mean(part**2))) for name, part in parts.items()},
            **facts,  # type: ignore[arg-type]
        )


def _optimal(job: _Job) -> ForceEstimate:
    """The smoother of `aerobalance.smoother` with its prior learned and its steps found."""
    d, recording = job.dynamics, job.recording
    channel = recording.channel(d.component)
    from_ground = load_from_ground(job.motion, d, rate=recording.rate, load_delay=channel.delay)
    reading = Reading(
        values=job.load - from_ground,
        interval=job.interval,
        dynamics=d,
        input_density=job.input_noise**2 * job.interval,
        noise=channel.noise,
    )
    steps, learned = find_steps(reading)
    filter_ = Filter.of(reading.system(learned), reading.present)
    columns = columns_of(steps, reading)
    shapes = np.column_stack([np.ones(reading.values.size), *(shape_of(step, reading) for step in steps)])
    sizes, _, _ = generalised_least_squares(filter_, reading.filled, columns)
    left = reading.filled - columns @ sizes
    states, variance = filter_.smooth(left)
    values = states[:, FORCE] + shapes @ sizes
    load_rate, load_acceleration = _load_derivatives(job, states, columns @ sizes + from_ground, values)
    _check_explained(job, filter_.whiten(left[:, None])[:, 0])
    parts = {
        "noise of the readings": np.sqrt(variance),
        "size and instant of steps": _shape_uncertainty(reading, filter_, steps, shapes, sizes),
        **job.parameter_uncertainty(load_rate, load_acceleration),
    }
    resolved = _resolved_bandwidth(reading, learned)
    return job.finish(
        values,
        parts,
        method=f"smoother: {learned.spectrum}, by Whittle's likelihood",
        noise=learned.noise,
        bandwidth=resolved,
        noise_gain=float(np.sqrt(np.mean(variance))) / learned.noise,
        steps=tuple(steps),
    )


def _check_explained(job: _Job, white: Array) -> None:
    """Warn where the readings depart from what balance and prior expect: the uncertainty there is too small."""
    count = max(white.size // EXPLAINED_BLOCK, 1)
    level = np.array([np.mean(block**2) for block in np.array_split(white, count)])
    # the mean square over m samples scatters by sqrt(2 / m); eight times that is never reached by chance
    strange = np.flatnonzero(level > 1 + 8 * np.sqrt(2 * count / white.size))
    if strange.size:
        worst = int(strange[np.argmax(level[strange])])
        start, stop = (job.recording.start + edge * white.size / count * job.interval for edge in (worst, worst + 1))
        warnings.warn(
            f"{job.recording.name}: in {strange.size} of {count} stretches the readings of {job.dynamics.component} "
            f"depart from what the model of balance and load expects, most between {start:.4g} and {stop:.4g} s "
            f"({np.sqrt(level[worst]):.2g} times the chance scatter); the uncertainty of the force there is too small",
            DoubtWarning,
            stacklevel=4,
        )


def _load_derivatives(job: _Job, states: Array, rest: Array, force: Array) -> tuple[Array, Array]:
    """First and second derivative of the load felt [N/s, N/s^2], by Eq. (8) of [Gorbushin2020]_, the force known.

    `rest` is the part of the load that is not in the smoother's state: response to steps and to the ground.
    """
    d = job.dynamics
    load = states[:, LOAD] + rest
    load_rate = states[:, LOAD_RATE] * d.angular_frequency + np.gradient(rest, job.interval)
    net = force + job.motion.force(d.mass)
    return load_rate, d.angular_frequency**2 * (net - load) - 2 * d.decay_rate * load_rate


def _shape_uncertainty(reading: Reading, filter_: Filter, steps: list[Step], shapes: Array, sizes: Array) -> Array:
    """Standard uncertainty from the sizes of constant and steps and from the steps' instants, shape (n,) [N]."""
    columns, forms = list(columns_of(steps, reading).T), list(shapes.T)
    small = 0.05 * reading.interval
    time = np.arange(reading.values.size) * reading.interval
    edge = np.zeros(time.size)
    for step, size in zip(steps, sizes[1:], strict=True):
        late, early = (Step(step.instant + shift, step.duration) for shift in (small, -small))
        columns.append(size * (response_to(late, reading) - response_to(early, reading)) / (2 * small))
        if step.duration > 0:
            forms.append(size * (shape_of(late, reading) - shape_of(early, reading)) / (2 * small))
        else:  # a pure step has no slope: each sample lies before or after it with some probability
            forms.append(np.zeros(time.size))
            after = norm.cdf((time - step.instant) / max(step.instant_uncertainty, 1e-12 * reading.interval))
            edge += size**2 * after * (1 - after)
    X = np.column_stack(columns)
    covariance = generalised_least_squares(filter_, reading.filled, X)[1]
    slopes = np.column_stack(
        [
            form - filter_.smooth(np.ascontiguousarray(column))[0][:, FORCE]
            for form, column in zip(forms, X.T, strict=True)
        ]
    )
    return np.asarray(np.sqrt(np.maximum(np.sum((slopes @ covariance) * slopes, axis=1), 0.0) + edge))


def _resolved_bandwidth(reading: Reading, learned: Learned) -> float:
    """Frequency up to which the force is stronger in the reading than the noise [Hz]; 0 if it is nowhere."""
    frequency = np.linspace(0, 0.5 / reading.interval, 4097)[1:]
    transfer = np.abs(reading.dynamics.response(frequency)) ** 2
    force = transfer * learned.spectrum.density(frequency)
    noise = transfer * reading.input_density + learned.noise**2 * reading.interval
    above = np.flatnonzero(force > noise)
    return float(frequency[above[-1]]) if above.size else 0.0


def _without_gaps(job: _Job, what: str) -> Array:
    load = job.load
    missing = int(np.count_nonzero(~np.isfinite(load)))
    if missing:
        raise FitError(
            f"{job.recording.name}: {missing} reading(s) of {job.dynamics.component} are missing and {what} cannot "
            "bridge them; use the smoother without a bandwidth"
        )
    return load


def _central_differences(job: _Job) -> ForceEstimate:
    """Eq. (17) of [Gorbushin2020]_ as it stands: AF' and AF'' by three-point central differences.

    The first and last sample have one neighbour only. The load is continued there by odd reflection, which makes AF''
    zero; repeating the neighbour's AF'' instead would give two samples the same amplified noise, which no later
    low-pass takes out. What this may miss is in the uncertainty of these two samples.
    """
    d, h = job.dynamics, job.interval
    load = _without_gaps(job, "central differences")
    load_rate = np.gradient(load, h)
    second = np.diff(load, 2) / h**2
    load_acceleration = np.concatenate(([0.0], second, [0.0]))
    ends = np.zeros(load.size)
    ends[[0, -1]] = d.mass / d.stiffness * np.abs(second[[0, -1]])
    known = _delayed_force(job)
    values = load + d.damping / d.stiffness * load_rate + d.mass / d.stiffness * load_acceleration - known
    noise = job.recording.channel(d.component).noise
    noise = white_noise(load) if noise is None else noise
    slope, curve = d.damping / d.stiffness / (2 * h), d.mass / d.stiffness / h**2
    gain = float(np.sqrt((1 - 2 * curve) ** 2 + (curve + slope) ** 2 + (curve - slope) ** 2))
    parts = {
        "noise of the readings": np.full(load.size, gain * noise),
        "noise of the ground motion": np.full(load.size, job.input_noise),
        "ends of the record": ends,
        **job.parameter_uncertainty(load_rate, load_acceleration),
    }
    bandwidth = DIFFERENCE_BANDWIDTH / h
    return job.finish(
        values,
        parts,
        method=f"paper: Eq. (17), three-point central differences, 3 dB low at {bandwidth:.4g} Hz",
        noise=noise,
        bandwidth=bandwidth,
        noise_gain=gain,
    )


def _delayed_force(job: _Job) -> Array:
    """Known force of the ground's motion at the load's sampling instants, shape (n,) [N]."""
    known = job.motion.force(job.dynamics.mass)
    lag = job.dynamics.delay + job.recording.channel(job.dynamics.component).delay - job.motion.delay
    if not lag or not known.any():
        return known
    return _filtered(known, job.interval, lambda f: np.exp(-2j * np.pi * f * lag))[0]


def _band_limited(job: _Job, bandwidth: float) -> ForceEstimate:
    """Eq. (17) of [Gorbushin2020]_ in the frequency domain, times a zero-phase Butterworth roll-off."""
    d, h = job.dynamics, job.interval
    if not 0 < bandwidth <= 0.5 / h:
        raise ValueError(
            f"bandwidth must lie between 0 and half the sampling rate ({0.5 / h:g} Hz), not {bandwidth:g}"
        )
    load = _without_gaps(job, "the band-limited inverse")

    def band(f: Array) -> Array:
        return np.asarray(1 / (1 + (f / bandwidth) ** (2 * BAND_ORDER)))

    def inverse(f: Array) -> Array:
        return np.asarray(band(f) / d.response(f))

    from_load, ends = _filtered(load, h, inverse)
    known = _delayed_force(job)
    from_ground, ground_ends = _filtered(known, h, band) if known.any() else (known, np.zeros(known.size))
    load_rate, _ = _filtered(load, h, lambda f: 2j * np.pi * f * band(f))
    load_acceleration, _ = _filtered(load, h, lambda f: -((2 * np.pi * f) ** 2) * band(f))
    noise = job.recording.channel(d.component).noise
    noise = white_noise(load) if noise is None else noise
    frequency = np.linspace(0, 0.5 / h, 8193)
    gain = float(np.sqrt(np.mean(np.abs(inverse(frequency)) ** 2)))
    parts = {
        "noise of the readings": np.full(load.size, gain * noise),
        "noise of the ground motion": np.full(load.size, job.input_noise * np.sqrt(np.mean(band(frequency) ** 2))),
        "ends of the record": np.hypot(ends, ground_ends),
        **job.parameter_uncertainty(load_rate, load_acceleration),
    }
    return job.finish(
        from_load - from_ground,
        parts,
        method=f"band-limited inverse to {bandwidth:g} Hz, zero phase, Butterworth roll-off of order {2 * BAND_ORDER}",
        noise=noise,
        bandwidth=bandwidth,
        noise_gain=gain,
    )


def _filtered(values: Array, interval: float, transfer) -> tuple[Array, Array]:  # type: ignore[no-untyped-def]
    """Apply a transfer function to a record; also the size of what the record's unknown continuation may do to it.

    The record is continued once by odd reflection and once by holding its end; the difference between the two answers
    is the uncertainty of the ends.
    """
    reach = min(values.size - 1, max(256, values.size // 4))
    answers = []
    for mode, options in (("reflect", {"reflect_type": "odd"}), ("edge", {})):
        padded = np.pad(values, reach, mode=mode, **options)  # type: ignore[call-overload]
        size = padded.size
        frequency = np.fft.rfftfreq(size, interval)
        spectrum = np.fft.rfft(padded) * transfer(frequency)
        answers.append(np.fft.irfft(spectrum, size)[reach : reach + values.size])
    return answers[0], np.abs(answers[0] - answers[1])
