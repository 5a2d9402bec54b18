r"""From the load felt to the force applied, Eq. (17) of [Gorbushin2020]_.

Three ways, one signature: the optimal estimator (the default), the paper's own derivatives, and the inverse limited to
a band. Each gives every sample a standard uncertainty.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np

from aerobalance.components import STANDARD_GRAVITY, si_unit
from aerobalance.contributions import Contribution, Noise, Systematic, total_deviation
from aerobalance.dynamics import Dynamics
from aerobalance.hum import Hum, Line, reading_of_lines
from aerobalance.motion import AXES, GroundMotion, Unknown, load_from_ground
from aerobalance.noise import white_noise
from aerobalance.prior import Learned, Reading
from aerobalance.problems import DoubtWarning, FitError
from aerobalance.recording import Array, Recording
from aerobalance.sensing import corrected
from aerobalance.smoothing import Estimator, Smoothed, taken_apart
from aerobalance.steps import Step

Method = Literal["smoother", "paper"]

FEWEST_SAMPLES: Final = 32
"""Shortest record that a force is worked out for."""

EXPLAINED_BLOCK: Final = 256
"""Samples over which it is looked whether the readings are explained."""

DIFFERENCE_BANDWIDTH: Final = 0.3183
"""Frequency, over the sampling rate, at which the three-point second difference is 3 dB low."""

DENSE: Final = 8193
"""Frequencies from zero to half the sampling rate at which a response is taken."""

PARAMETERS_NAME: Final = "mass, stiffness, damping, delay"
"""Name of what the dynamics contribute to the uncertainty."""

PROBE: Final = 0.1
"""Change of a parameter, in standard uncertainties, over which the estimator's slope is taken."""

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
    learned: Learned | None = None


def reconstruct(
    recording: Recording,
    dynamics: Dynamics,
    *,
    method: Method = "smoother",
    bandwidth: float | None = None,
    gravity: float = STANDARD_GRAVITY,
    gravity_uncertainty: float = 0.0,
    hum: Hum = "mains",
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
    gravity, gravity_uncertainty
        Local acceleration of gravity and its standard uncertainty [m/s^2].
    hum
        What the smoother takes for hum and not for force: ``"mains"`` steady lines at 50 or 60 Hz and harmonics that
        stand out of the reading (with a `DoubtWarning` that names them), ``"keep"`` none, or lines near given
        frequencies [Hz].

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
    motion = GroundMotion.of(recording, dynamics.component, gravity=gravity, gravity_uncertainty=gravity_uncertainty)
    return with_motion(recording, dynamics, motion, method=method, bandwidth=bandwidth, hum=hum)


def with_motion(
    recording: Recording,
    dynamics: Dynamics,
    motion: GroundMotion,
    *,
    method: Method = "smoother",
    bandwidth: float | None = None,
    hum: Hum = "mains",
) -> ForceEstimate:
    """Work out the force as `reconstruct` does, with the motion of the ground end given."""
    if not np.isfinite(dynamics.natural_frequency):
        raise FitError(
            f"mass and stiffness of {dynamics.component} leave the range that can be calculated with; check the units"
        )
    if not isinstance(hum, str) and (bandwidth is not None or method != "smoother"):
        raise ValueError("only the smoother without a bandwidth can take lines for hum")
    job = _Job(corrected(recording), dynamics, motion)
    if bandwidth is not None:
        return _band_limited(job, bandwidth)
    if method == "paper":
        return _central_differences(job)
    if method == "smoother":
        return _optimal(job, hum)
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
    matrix = _gain_and_offset(estimate.values, filled)
    return replace(
        estimate,
        uncertainty=np.hypot(estimate.uncertainty, filled),
        budget={**estimate.budget, matrix.name: float(np.sqrt(np.mean(filled**2)))},
        contributions=(*estimate.contributions, matrix),
    )


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
    return Systematic("balance matrix, zeros and tares", "balance", names, slopes, covariance)


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

    @property
    def motion_source(self) -> str:
        """Channels that the noise of the ground's motion comes from."""
        axis = AXES.get(self.dynamics.component, "")
        names = [name for name in (f"ground_acceleration{axis}", "pitch") if name in self.recording]
        return " and ".join(names) or "ground_acceleration"

    def parameter_errors(self, values: Array, again: Callable[[_Job], Array]) -> Systematic:
        """What the parameters of the dynamics do to the force: the method is run again with each of them changed.

        The slopes of Eq. (17) of [Gorbushin2020]_ would say too much where the smoother's prior has no force at a
        frequency, and too little where a wrong frequency makes a wrong step.
        """
        d = self.dynamics
        slopes = np.zeros((values.size, len(d.parameters)))
        for place, deviation in enumerate(np.sqrt(np.diag(d.covariance))):
            if deviation > 0:
                changed = d.values
                changed[place] += PROBE * deviation
                moved = again(replace(self, dynamics=d.with_parameters(changed)))
                slopes[:, place] = (moved - values) / (PROBE * deviation)
        return Systematic(PARAMETERS_NAME, "dynamics", d.parameters, slopes, d.covariance)

    def motion_errors(self, through: Callable[[Unknown], Array]) -> list[Contribution]:
        """What holds along the ground's motion and is not known, by what a unit of it does to the force, (n,)."""
        return [
            Systematic(item.name, item.source, (item.name,), through(item)[:, None], np.array([[item.uncertainty**2]]))
            for item in self.motion.unknowns
        ]

    def as_force(self, item: Unknown) -> Array:
        """Force that a unit of an unknown of the ground's motion is taken for by a direct inverse, shape (n,)."""
        return self.dynamics.mass * item.slope

    def reading_errors(self, values: Array) -> list[Contribution]:
        """Gain and zero of the load's channel: a gain acts on all that the readings say of the net force."""
        channel = self.recording.channel(self.dynamics.component)
        net = values + self.motion.force(self.dynamics.mass)
        unknown = (
            ("gain of the readings", net, channel.relative_uncertainty),
            ("zero of the readings", np.ones(values.size), channel.zero_uncertainty),
        )
        return [
            Systematic(name, channel.name, (name,), slope[:, None], np.array([[u**2]]))
            for name, slope, u in unknown
            if u > 0
        ]

    def finish(self, values: Array, contributions: list[Contribution], **facts: object) -> ForceEstimate:
        """Put the answer together; a contribution that is nothing is left out, but for those that are always there."""
        contributions = [*contributions, *self.reading_errors(values)]
        parts = tuple(part for part in contributions if part.deviation.any() or part.source == "dynamics")
        return ForceEstimate(
            component=self.dynamics.component,
            values=values,
            uncertainty=total_deviation(parts),
            assumptions=self.motion.assumptions,
            budget={part.name: float(np.sqrt(np.mean(part.deviation**2))) for part in parts},
            contributions=parts,
            **facts,  # type: ignore[arg-type]
        )


def _optimal(job: _Job, hum: Hum) -> ForceEstimate:
    """The smoother of `aerobalance.smoother` with its prior learned and its steps found."""
    d = job.dynamics
    apart = taken_apart(reading_of(job.recording, d, job.motion), hum=hum)
    reading, steps, learned = apart.reading, apart.steps, apart.learned
    fit = Smoothed.of(reading, learned=learned, steps=steps)
    level = _unexplained(job, fit.innovations)
    lines = fit.sized(apart.hum)
    if hum == "mains":
        _tell_of_hum(job, lines, large=apart.large)

    def run(other: _Job) -> Array:
        changed = reading_of(other.recording, other.dynamics, other.motion, hum=reading.hum)
        estimator = fit.estimator if other is job else Estimator.of(changed, learned=learned, steps=steps)
        return estimator.run(changed.filled[:, None])[:, 0]

    def moved(item: Unknown) -> Array:
        unit, delay = replace(job.motion, specific_force=item.slope), job.recording.channel(d.component).delay
        felt = load_from_ground(unit, d, rate=job.recording.rate, load_delay=delay)
        return -fit.estimator.run(np.where(reading.present, felt, 0.0)[:, None])[:, 0]

    return job.finish(
        fit.force,
        [
            *fit.noise_errors(level, sources=(d.component, job.motion_source)),
            *fit.step_errors(),
            job.parameter_errors(run(job), run),
            *job.motion_errors(moved),
        ],
        method=f"smoother: {learned.spectrum}, by Whittle's likelihood",
        noise=learned.noise,
        bandwidth=_resolved_bandwidth(reading, learned),
        noise_gain=float(np.sqrt(np.mean(fit.variance))) / learned.noise,
        steps=tuple(steps),
        hum=lines,
        learned=learned,
    )


def _tell_of_hum(job: _Job, lines: tuple[Line, ...], *, large: tuple[Line, ...]) -> None:
    """Say which lines at frequencies of the mains are not in the force, and which are because they are large."""
    told = (
        (
            lines,
            (
                "are taken for mains hum and not for force; if a force was applied at such a frequency it is missing "
                'from the result: keep it with --hum keep (hum="keep")'
            ),
        ),
        (
            large,
            (
                "lie where the mains do, but are so large a part of the record that they are taken for force; if they "
                "are hum, the force is wrong by them: name their frequencies with --hum"
            ),
        ),
    )
    unit = si_unit(job.dynamics.component)
    for some, what in told:
        named = [f"{line.frequency:.7g} Hz ({line.amplitude:.3g} {unit} in the reading)" for line in some]
        if named:
            warnings.warn(
                f"{job.recording.name}: steady lines of {job.dynamics.component} at {', '.join(named)} {what}",
                DoubtWarning,
                stacklevel=5,
            )


def without_hum(recording: Recording, estimate: ForceEstimate) -> Recording:
    """The recording without the lines of hum that an estimate has found in its component's readings."""
    if not estimate.hum:
        return recording
    load = recording.channel(estimate.component)
    hum = reading_of_lines(estimate.hum, count=load.values.size, interval=1 / recording.rate)
    return replace(recording, channels={**recording.channels, load.name: replace(load, values=load.values - hum)})


def reading_of(
    recording: Recording, dynamics: Dynamics, motion: GroundMotion, *, hum: tuple[float, ...] = ()
) -> Reading:
    """The record as the estimator takes it: the load that the ground's motion has put on it is taken off.

    Hum is named by its frequencies [Hz] and left in; readings that rest on a limit count as missing.
    """
    channel = corrected(recording).channel(dynamics.component)
    from_ground = load_from_ground(motion, dynamics, rate=recording.rate, load_delay=channel.delay)
    return Reading(
        values=np.where(recording.channel(dynamics.component).at_limit, np.nan, channel.values - from_ground),
        interval=1 / recording.rate,
        dynamics=dynamics,
        input_density=(dynamics.mass * motion.noise) ** 2 / recording.rate,
        noise=channel.noise,
        hum=hum,
    )


def _unexplained(job: _Job, white: Array) -> Array:
    """Variance of the innovations over what is expected, 1 where chance explains it, shape (n,); warns elsewhere."""
    count = max(white.size // EXPLAINED_BLOCK, 1)
    blocks = np.array_split(white, count)
    level = np.array([np.mean(block**2) for block in blocks])
    # the mean square over m samples scatters by sqrt(2 / m); eight times that is never reached by chance
    strange = np.flatnonzero(level > 1 + 8 * np.sqrt(2 * count / white.size))
    if strange.size:
        worst = int(strange[np.argmax(level[strange])])
        start, stop = (job.recording.start + edge * white.size / count * job.interval for edge in (worst, worst + 1))
        warnings.warn(
            f"{job.recording.name}: in {strange.size} of {count} stretches the readings of {job.dynamics.component} "
            f"depart from what the model of balance and load expects, most between {start:.4g} and {stop:.4g} s "
            f"({np.sqrt(level[worst]):.2g} times the chance scatter); the uncertainty from noise is raised by as much "
            "there, but an error that the model makes everywhere is not in it",
            DoubtWarning,
            stacklevel=4,
        )
    raised = np.ones(count)
    raised[strange] = level[strange]
    return np.repeat(raised, [block.size for block in blocks])


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
    frequency = np.linspace(0, np.pi, DENSE)
    density = (1 - 2 * curve + 2 * curve * np.cos(frequency)) ** 2 + (2 * slope * np.sin(frequency)) ** 2
    parts = [
        Noise("noise of the readings", d.component, np.full(load.size, gain * noise), density / gain**2),
        Noise("noise of the ground motion", job.motion_source, np.full(load.size, job.input_noise), np.ones(1)),
        Noise("ends of the record", d.component, ends, np.ones(1)),
        job.parameter_errors(values, lambda other: _central_differences(other).values),
        *job.motion_errors(job.as_force),
    ]
    bandwidth = DIFFERENCE_BANDWIDTH / h
    further = ", ".join(f"{mode.natural_frequency:.4g}" for mode in d.further_modes)
    left = f"; one mode only, {further} Hz left out" if further else ""
    return job.finish(
        values,
        parts,
        method=f"paper: Eq. (17), three-point central differences, 3 dB low at {bandwidth:.4g} Hz{left}",
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
    values = from_load - from_ground
    noise = job.recording.channel(d.component).noise
    noise = white_noise(load) if noise is None else noise
    frequency = np.linspace(0, 0.5 / h, DENSE)
    gain = float(np.sqrt(np.mean(np.abs(inverse(frequency)) ** 2)))
    density, passed = np.abs(inverse(frequency)) ** 2, band(frequency) ** 2
    of_ground = np.full(load.size, job.input_noise * np.sqrt(np.mean(passed)))
    parts = [
        Noise("noise of the readings", d.component, np.full(load.size, gain * noise), density / gain**2),
        Noise("noise of the ground motion", job.motion_source, of_ground, passed / np.mean(passed)),
        Noise("ends of the record", d.component, np.hypot(ends, ground_ends), np.ones(1)),
        job.parameter_errors(values, lambda other: _band_limited(other, bandwidth).values),
        *job.motion_errors(job.as_force),
    ]
    return job.finish(
        values,
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
