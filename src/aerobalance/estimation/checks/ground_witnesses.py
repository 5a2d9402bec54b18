"""Components whose loads show the ground's motion, and what they feel where one of its channels reads differently."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import chdtrc, chdtri, ndtr, ndtri

from aerobalance.estimation.checks.stretches import Stretches, passed_by
from aerobalance.estimation.force_smoother import SmootherResult, instant_columns
from aerobalance.estimation.prior import fit_prior
from aerobalance.estimation.record import ComponentRecord
from aerobalance.estimation.statespace.kalman import KalmanFilter
from aerobalance.motion.changes import MotionChanges
from aerobalance.motion.platform import SystematicParameter, driven_column
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import kept_warnings
from aerobalance.recording.fourier import hann
from aerobalance.recording.linalg import table_covariance
from aerobalance.recording.noise import channel_noise
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import interpolate_gaps_linearly


@dataclass(frozen=True, slots=True)
class GroundChannelSettings:
    """Thresholds of the comparison of ground channels with the load.

    Attributes
    ----------
    sure
        Standard uncertainties that a delay or a gain has to be off, of one channel: once in 2000 by chance, as often
        as one of several then.
    open
        Gain in log-likelihood of a delay or a gain below that of `sure` from which on the record leaves it open. Once
        in 370 by chance of one channel: three standard uncertainties in place of 3.5.
    steepness
        Change of the logit of its probability with that gain: as likely as not where it is sure.
    beside
        Error of the force from a gain over that from a delay, and the other way, from which both are told: the one is
        else what the other does to second order.
    second_order
        Loss of gain over what a delay makes at one frequency, up to which it is the delay's. A fit to first order
        tells a large delay too small: of turns of up to 40 Hz that were 5 ms late it told 4 ms, and 1.5 to 1.7 times
        that loss.
    clock
        Change of a delay along the record over the delay, from which it is told: a delay makes less to second order.
    matters
        Error of the force from it over the uncertainty of the force (both rms) from which it is told.
    worth_a_look
        Chi-square of delay, gain and drift (three degrees of freedom) from which the force's spectrum is learned again
        without them, of one channel: once in ten by chance, as often as of one of several then. With what is left of
        the motion in the force it is far less than without.
    bands, stands_out
        Bands of a channel's spectrum, and the level over that of its noise from which there is motion.
    clear
        Level over that of the noise from which a line is motion: a hundredth of it is noise then, by which a gain is
        told too small.
    lines, parts, lines_of_part, sudden
        Lines before and after one, itself among them, in which motion stands out if that one is motion; parts of a
        record in which motion is looked for that is not all along it, the lines there, and its level over the median
        of all parts.
    passed
        Frequency over the highest that stands out up to which a channel is taken as it is, and from which not at all.
    probe
        Delay by which slopes are taken [samples], and change of the gain [1].
    most
        Delay that an alignment takes off at once [samples].
    settled
        What is left of delay and gain over their standard uncertainties, from which on an alignment is at its end.
    rounds
        Most times that delay and gain are looked for.
    reach
        Largest delay that is tried, over the length of the record. Before the loads are asked, a delay and its change
        along the record are expected within that (standard deviation).
    gains
        Change of a gain that is expected before the loads are asked (standard deviation) [1]: mistaken units and signs
        are told to far better than that where the loads show the channel at all. Else a channel that hardly moves, or
        that moves in a straight line, whose gain looks like a drift of its clock, would have any gain by chance.
    apart, beyond_slopes
        Part of a period of the motion (its rms frequency), and so many of them from which on slopes do not tell a
        delay any more.
    promising, decisive
        Gain in log-likelihood of a delay of these from which on the force's spectrum is learned again without it, and
        that it must have then.
    about_peak
        Log-likelihood below its maximum down to which delays tell their uncertainty: two of it either way.
    coherent, part
        Lines in a band in which the coherence of components is taken as one, at least, and the part of its frequency.
    least
        Least level of a combination of components over that of one: where they have nearly all of their noise in
        common, what is left is less than the shapes are exact by. More noise than there is leaves u no smaller.
    disagree, inexact
        Probability by chance of what the components show of a channel each for itself, beyond what all of them show,
        from which on they disagree; and the least part of what all of them show that it has to be. Where the motion is
        much larger than the noise, shapes are not as exact as chance is small: a delay is told to first order, half a
        radian of it to a quarter, and a sixteenth of the squares.
    beyond
        Samples beyond those that a declared delay leaves out, by which a shape there is not exact yet.
    """

    sure: float = 3.5
    open: float = 1.625
    steepness: float = 0.8
    beside: float = 0.5
    second_order: float = 2.0
    clock: float = 0.2
    matters: float = 0.3
    worth_a_look: float = 6.25
    bands: int = 100
    stands_out: float = 30.0
    clear: float = 100.0
    lines: int = 9
    parts: int = 16
    lines_of_part: int = 4
    sudden: float = 100.0
    passed: tuple[float, float] = (2.0, 4.0)
    probe: float = 0.02
    most: float = 64.0
    settled: float = 0.1
    rounds: int = 5
    reach: float = 0.125
    gains: float = 10.0
    apart: float = 0.05
    beyond_slopes: float = 2.0
    promising: float = 3.0
    decisive: float = 12.0
    about_peak: float = 2.0
    coherent: int = 64
    part: int = 10
    least: float = 0.5
    disagree: float = 1e-6
    inexact: float = 0.1
    beyond: int = 2


SETTINGS: Final = GroundChannelSettings()
"""Thresholds that are used."""


SHAPES: Final = 3
"""Shapes of a channel: its rate, itself, and its rate growing along the record."""


@dataclass(frozen=True, eq=False)  # without slots: what is worked out once is kept
class Witness:
    """A component whose load shows the ground's motion.

    Attributes
    ----------
    record
        The component with its record.
    fit
        Its force by the smoother.
    """

    record: ComponentRecord
    fit: SmootherResult

    @property
    def known(self) -> Array:
        """Balance load under constant, steps and hum, shape (n, p)."""
        return instant_columns(self.fit.reading, self.fit.steps, heights=[step.height for step in self.fit.steps])[0]

    def felt(self, slope: Array) -> Array:
        """Balance load under a change of the ground's specific force, shapes (n,) and (n,) or (n, 6)."""
        return self.record.felt_under(SystematicParameter("", "", slope, 0.0))

    @cached_property
    def passed(self) -> NDArray[np.complex128]:
        """What the smoother makes of a balance load at the frequencies of a stretch, shape (m,) [1]."""
        size = Stretches.size_in(self.fit.force.size)
        frequency = np.asarray(np.fft.rfftfreq(size, self.fit.reading.interval), dtype=np.float64)
        return np.asarray(passed_by(self.fit, frequency) / self.fit.reading.dynamics.response(frequency))

    def force_under(self, felt: Array) -> float:
        """Rms of what a balance load, shape (n,), makes of the force, by stretches of it [N]."""
        shown = Stretches.of(felt)
        return float(np.sqrt(shown.power_of(shown.lines * self.passed) + np.var(shown.means)))

    def without(self, load: Array) -> KalmanFilter:
        """The filter of the prior that is learned anew, a balance load in the readings left out, shape (n,)."""
        # what was learned took what is left of the motion for force: with it taken out the force is less
        reading = self.fit.reading
        less = replace(reading, values=reading.values - load)
        prior = fit_prior(less, columns=self.known, before=self.fit.learned)
        return KalmanFilter.of(reading.system(prior), reading.present)


@dataclass(frozen=True, slots=True, eq=False)
class ChannelShapes:
    """What a channel changes where it is read differently.

    Attributes
    ----------
    name
        The channel.
    slopes
        The specific force that a unit of each of its shapes makes, shape (n,) or (n, 6) each.
    felt
        The load of each component felt under it, shape (n, p) each [N].
    moves
        Lines at which the channel shows motion, of series as long as `length_of` says, shape (m,): at others the
        shapes are its noise, which is in the readings as the motion is that was taken off, and tells no gain.
    """

    name: str
    slopes: tuple[Array, ...]
    felt: tuple[Array, ...]
    moves: NDArray[np.bool_]

    @property
    def pace(self) -> float:
        """Frequency of its motion, rms [Hz times the interval of the samples]."""
        motion = self.slopes[1].reshape(self.slopes[1].shape[0], -1)
        own = motion[:, int(np.argmax(np.diag(table_covariance(motion))))]
        return float(np.std(np.diff(own))) / (2 * np.pi * float(np.std(own)))


@dataclass(frozen=True, eq=False)
class Witnesses:
    """Components whose loads are asked together.

    Attributes
    ----------
    recording
        The record with the channels of the ground's motion.
    all
        The components: one that is not coupled with others, or all that are.
    along
        The one component whose axis alone the motion is described along; None where it is in six.
    """

    recording: Recording
    all: tuple[Witness, ...]
    along: str | None

    @property
    def components(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(one.record.dynamics.component for one in self.all)

    def unseen(self, component: str) -> int:
        """Samples at either end that a load and the ground's channels, by their delays, do not both show."""
        own = self.recording.channel(component).delay
        late = [abs(own - self.recording.channel(name).delay) for name in self.changes.channels]
        count = int(max(late, default=0.0) * self.recording.rate)
        return count + SETTINGS.beyond if count else 0

    @cached_property
    def changes(self) -> MotionChanges:
        """What the motion becomes where a channel reads something else."""
        with kept_warnings():  # they were given when the force was estimated
            return MotionChanges.of(self.recording, along=self.along)

    def shapes_of(self, name: str) -> ChannelShapes | None:
        """Its rate and itself, of one channel; None where it does not show the motion."""
        channel, interval = self.recording.channel(name), 1 / self.recording.rate
        values = interpolate_gaps_linearly(channel.values)
        if not np.isfinite(values).all() or float(np.ptp(values)) == 0:
            return None
        # noise of the channel is no motion: taken along, it would make every gain and delay too small
        values = values - values.mean()
        noise = channel_noise(channel)
        moves = lines_of_motion(values, noise=noise)
        motion, rate = above_noise(values, moves, noise=noise)
        late = -SETTINGS.probe * rate
        slopes = [
            self.change(name, change) / size
            for change, size in ((late, SETTINGS.probe * interval), (SETTINGS.probe * motion, SETTINGS.probe))
        ]
        if not all(slope.any() for slope in slopes):
            return None
        # what is left in the readings where the channel is so late or reads so much less
        felt = tuple(np.column_stack([one.felt(slope) for slope in slopes]) for one in self.all)
        return ChannelShapes(name, tuple(slopes), felt, moves)

    def with_drift(self, shapes: ChannelShapes) -> ChannelShapes:
        """Shapes of a channel with its rate growing along the record."""
        rate = shapes.slopes[0]
        slope = (rate.T * ramp_of(rate.shape[0])).T
        felt = tuple(np.column_stack([own, one.felt(slope)]) for one, own in zip(self.all, shapes.felt, strict=True))
        return replace(shapes, slopes=(*shapes.slopes, slope), felt=felt)

    @property
    def expected(self) -> Array:
        """Standard deviations of a channel's shapes before the loads are asked, shape (3,): [s], [1], [s]."""
        late = SETTINGS.reach * self.recording.samples / self.recording.rate
        return np.array([late, SETTINGS.gains, late])

    @property
    def most(self) -> Array:
        """Largest sizes of a channel's shapes that are looked for, shape (3,): [s], [1], [s]."""
        late = self.expected[0]
        return np.array([late, np.inf, 2 * late])  # from early to late along the record

    @property
    def sure(self) -> float:
        """Standard uncertainties that a delay or a gain of one of the channels has to be off."""
        return -float(ndtri(ndtr(-SETTINGS.sure) / len(self.changes.channels)))

    @property
    def worth_a_look(self) -> float:
        """Chi-square of a channel's shapes from which on the force's spectrum is learned again without them."""
        return float(chdtri(SHAPES, chdtrc(SHAPES, SETTINGS.worth_a_look) / len(self.changes.channels)))

    @property
    def least(self) -> float:
        """Standard uncertainties from which on the record leaves open whether it is off."""
        return float(np.sqrt(max(self.sure**2 - 2 * SETTINGS.open, 0.0)))

    def promising(self, pace: float) -> float:
        """Gain in log-likelihood of a delay from which on a channel is looked at closely; of motion at this pace.

        Of one component a look in vain costs little. Of several every prior is learned again: there the gain is more
        than the best of so many delays, channels and components brings by chance.
        """
        if len(self.all) == 1:
            return SETTINGS.promising
        delays = max(4 * SETTINGS.reach * self.recording.samples * pace, 1.0)
        return SETTINGS.promising + float(np.log(delays * len(self.changes.channels) * len(self.all)))

    def change(self, name: str, by: Array) -> Array:
        """Change of the specific force where a channel reads more by this, shape (n,), or (n, 6) of coupled ones."""
        change = self.changes.specific_force(name, by)
        return change if self.along is None else change[:, driven_column(self.along)]


def ramp_of(count: int) -> Array:
    """Return a line from -1/2 to 1/2 along so many samples [1]."""
    return np.asarray(np.arange(count) / max(count - 1, 1) - 0.5)


def above_noise(values: Array, moves: NDArray[np.bool_], *, noise: float) -> tuple[Array, Array]:
    """Return a channel without its white noise far above the band of its motion, and its rate, in its unit.

    It is as it is up to twice the highest frequency that stands out of the noise. A motion that goes on beyond the
    ends of a record has lines above its band: cut off there, it would swing beside the ends as no load does.

    Parameters
    ----------
    values
        Its readings less their mean, without gaps, shape (n,).
    moves
        Lines at which it stands out, by `lines_of_motion`.
    noise
        Standard uncertainty of a reading.

    Returns
    -------
    motion, rate
        Shape (n,) each; the rate for each sampling interval.
    """
    count = values.size
    if not _moves(values, noise=noise):
        return np.zeros(count), np.zeros(count)
    line = np.linspace(values[0], values[-1], count)
    highest = max(np.flatnonzero(moves), default=0)
    # reflected at points, its rate goes on at the ends: what a bend there does, the load would have to show as well
    reflected = np.concatenate([values - line, (line - values)[::-1]])
    lines = rfft(reflected)
    over = np.arange(lines.size) / (2 * count) / (max(float(highest), 1.0) / length_of(count))
    whole, none = SETTINGS.passed
    lines *= 0.5 + 0.5 * np.cos(np.pi * np.clip((over - whole) / (none - whole), 0.0, 1.0))
    lines[0] = 0.0
    by_rate = 1j * np.pi * np.arange(lines.size) / count
    motion, rate = (irfft(one, 2 * count)[:count] for one in (lines, by_rate * lines))
    return np.asarray(line + motion), np.asarray(line[1] - line[0] + rate)


def length_of(count: int) -> int:
    """Samples of a series of so many with as many zeros behind it as a delay may have, an even number."""
    return 2 * int(next_fast_len(-(-int(count * (1 + SETTINGS.reach)) // 2), real=True))


def lines_of_motion(values: Array, *, noise: float) -> NDArray[np.bool_]:
    """Lines at which a channel stands out of its white noise, of a series as long as `length_of` says, shape (m,).

    The window lets nothing leak beyond the band of the motion, as the ends of the record do: the lines before one and
    those after it stand out both. A motion near the ends alone, or a short one, is looked for in parts of the record
    beside it, whose windows spread the lines of a steady motion: there it has to stand out of the other parts as well.

    Parameters
    ----------
    values
        Its readings less their mean, without gaps, shape (n,).
    noise
        Standard uncertainty of one of them.
    """
    least, count = SETTINGS.clear * noise**2, values.size
    moves = _own_level(values[None], length_of(count), SETTINGS.lines)[0] > least
    size = count // SETTINGS.parts
    if size < 4 * SETTINGS.lines_of_part:
        return np.asarray(moves)
    parts = sliding_window_view(values, size)[np.linspace(0, count - size, 2 * SETTINGS.parts - 1).astype(int)]
    level = _own_level(parts - parts.mean(axis=1, keepdims=True), size, SETTINGS.lines_of_part)
    sudden = (level > np.maximum(least, SETTINGS.sudden * np.median(level, axis=0))).any(axis=0)
    if not sudden.any():
        return np.asarray(moves)
    places = np.arange(moves.size) / length_of(count) * size
    return np.asarray(moves | (np.interp(places, np.arange(sudden.size), sudden) > 0))


def _own_level(series: Array, length: int, lines: int) -> Array:
    """Power of the lines about each line of windowed series (k, n), on the side where it is less, shape (k, m)."""
    window = hann(series.shape[1]) ** 2
    power = np.square(np.abs(rfft(series * window, length))) / float(window @ window)
    return np.minimum(_mean_of_following(power, lines), _mean_of_following(power[:, ::-1], lines)[:, ::-1])


def _mean_of_following(power: Array, lines: int) -> Array:
    """Mean of each line and those that follow it, so many and fewer at the end, shape (k, m)."""
    total = np.pad(np.cumsum(power, axis=1), ((0, 0), (1, 0)))
    first = np.arange(power.shape[1])
    last = np.minimum(first + lines, power.shape[1])
    return np.asarray((total[:, last] - total[:, :-1]) / (last - first))


def _levels(lines: NDArray[np.complex128]) -> tuple[NDArray[np.intp], Array]:
    """Bands of a reflected series, their first lines and the one after the last, and the mean power in each."""
    power = np.square(np.abs(lines)) / (2 * (lines.size - 1))
    edges = np.unique(np.round(np.geomspace(1, power.size, SETTINGS.bands)).astype(int))
    return edges, np.add.reduceat(power, edges[:-1]) / np.diff(edges)


def _moves(values: Array, *, noise: float) -> bool:
    """Whether a channel stands out of its white noise in any band.

    Reflected as they are: a line through two readings that are noise would be motion of the size of the noise.
    """
    _, level = _levels(rfft(np.concatenate([values, values[::-1]])))
    return bool((level > SETTINGS.stands_out * noise**2).any())
