"""The waveform of a ringing load, fitted by separable least squares.

Decay rate, frequency, instant and duration of the release and the frequencies of further lines are searched; offset,
drift, height and all amplitudes are linear and follow from them (variable projection [Golub1973]_).

References
----------
.. [Golub1973] G. H. Golub, V. Pereyra, "The differentiation of pseudo-inverses and nonlinear least squares problems
   whose variables separate", SIAM J. Numer. Anal. 10 (1973) 413.
.. [Kaufman1975] L. Kaufman, "A variable projection method for solving separable nonlinear least squares problems", BIT
   15 (1975) 49.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, lstsq

from aerobalance.dynamics.modal import exponentials
from aerobalance.dynamics.single import Dynamics
from aerobalance.identification.free_decay.event import Shape
from aerobalance.recording.channel import Array

HEAVIEST: Final = 0.3
"""Damping ratio above which a further line or mode is none but the misfit of something else."""

STEEPEST_RISE: Final = 50.0
"""Logarithm of the growth at which a rising trial waveform is cut, so that numbers stay finite."""

ALIKE: Final = 1e-4
"""Part of a column's size that no other column shows, below which the normal equations are too poor."""


@dataclass(frozen=True, slots=True)
class DecayLine:
    """A further line in a ringing record: steady (hum, decay 0) or another mode.

    Attributes
    ----------
    frequency
        Frequency [Hz].
    decay
        Decay rate [1/s]; 0 for a steady line.
    """

    frequency: float
    decay: float = 0.0


@dataclass(frozen=True, slots=True)
class Law:
    """How decay rate and frequency change with the amplitude: in proportion to a power of it.

    With A the amplitude over that at the start of the ringing the decay rate is a (1 - s + s A^n) and the angular
    frequency w (1 + k A^m): n = -1 is dry friction beside what is viscous, 1 a drag that grows with the square of the
    speed, 2 a spring or damper that is bent.

    Attributes
    ----------
    damping, frequency
        The powers n and m.
    """

    damping: int
    frequency: int


@dataclass(frozen=True, slots=True, eq=False)
class DrivingForce:
    """A force that acts on the balance while it rings.

    Attributes
    ----------
    density
        Its two-sided density near the natural frequency [N^2/Hz].
    band
        Frequencies between which it was looked at [Hz].
    objective
        Minus the logarithm of the likelihood.
    parameters, centre
        Logarithms of the density of the readings' noise and of `density`, and how the latter changes from the middle
        of the band to its end; and where they are thought to be before, shape (3,).
    """

    density: float
    band: tuple[float, float]
    objective: float
    parameters: Array
    centre: Array


@dataclass(frozen=True, slots=True, eq=False)
class Ring:
    """A fitted ringing load.

    Attributes
    ----------
    shape
        ``"release"``: held and let go at once. ``"ramp"``: let go over a duration. ``"free"``: ringing only, with
        amplitude and phase of its own.
    frequency, decay
        Damped frequency [Hz] and decay rate [1/s].
    start, duration
        Instant of the release, or of the first sample used for ``"free"`` [s], and its duration [s].
    lines
        Further lines.
    sizes
        Sizes of the linear columns: offset, drift, height or amplitudes, lines; and where bent the change of decay
        rate and of frequency with the envelope, each over the mean and times the height.
    bent
        Whether decay rate and frequency may change with the envelope.
    vector
        Nonlinear parameters: decay rate, damped angular frequency, instant and duration where fitted, and for each
        line its angular frequency and, where it decays, its decay rate; last s and k of the law where there is one.
    covariance
        Of `vector` and `sizes`, in this order.
    colour
        Spectrum of the residuals near the ring over that of white noise, 1 where the residuals pass as white.
    residuals
        Readings less waveform; where a force drives it the innovations, each over its own deviation times that of the
        noise.
    force
        The force that acts all along; None where the readings show none.
    law
        How decay rate and frequency, which are those of the first amplitude, change with it; None where they do not.
    """

    shape: Shape
    frequency: float
    decay: float
    start: float
    duration: float
    lines: tuple[DecayLine, ...]
    bent: bool
    vector: Array
    sizes: Array
    covariance: Array
    colour: float
    time: Array
    values: Array
    residuals: Array
    rate: float
    force: DrivingForce | None = None
    law: Law | None = None

    @property
    def squares(self) -> float:
        """Sum of squared residuals [N^2]."""
        return float(self.residuals @ self.residuals)

    @property
    def degrees_of_freedom(self) -> int:
        """Samples less parameters."""
        return self.time.size - self.vector.size - self.sizes.size

    @property
    def variance(self) -> float:
        """Variance of the residuals [N^2]."""
        return self.squares / max(self.degrees_of_freedom, 1)

    @property
    def height(self) -> float:
        """Load before the release less the load after [N]; 0 where the ring is free."""
        return 0.0 if self.shape == "free" else float(self.sizes[2])

    @property
    def amplitude(self) -> float:
        """Amplitude of the ringing at its start [N]."""
        return abs(self.height) if self.shape != "free" else float(np.hypot(self.sizes[2], self.sizes[3]))

    def line_sizes(self) -> list[float]:
        """Amplitude of every further line [N]."""
        return [float(np.linalg.norm(self.sizes[self._size_places(number)])) for number in range(len(self.lines))]

    def modes(self) -> tuple[Array, Array]:
        """Decay rate, damped angular frequency and height of the first mode and, after a release, of the further ones.

        Returns
        -------
        values
            Shape (m, 3) [1/s, rad/s, N]; heights have signs. A free ring has no height: 1 stands for it.
        slopes
            Their derivatives by the rows of `covariance`, shape (m, 3, p).
        """
        released = self.shape != "free"
        nonlinear = self.vector.size
        rows = [(0, 1, nonlinear + 2)]
        place = 2 + released + (self.shape == "ramp")
        for number, line in enumerate(self.lines):
            if line.decay > 0 and released:
                rows.append((place + 1, place, nonlinear + self._size_places(number).start))
            place += 1 + (line.decay > 0)
        every = np.concatenate([self.vector, self.sizes])
        values, slopes = every[np.array(rows)], np.eye(every.size)[np.array(rows)]
        slopes[:, 0] *= np.sign(values[:, :1])
        values[:, 0] = np.abs(values[:, 0])
        if not released:
            values[:, 2], slopes[:, 2] = 1.0, 0.0
        return values, slopes

    def _size_places(self, number: int) -> slice:
        """Places of a line's amplitudes in `sizes`."""
        place = 4 if self.shape == "free" else 3
        widths = [1 if line.decay > 0 and self.shape != "free" else 2 for line in self.lines]
        place += sum(widths[:number])
        return slice(place, place + widths[number])


def columns_of(
    time: Array,
    shape: Shape,
    vector: Array,
    lines: tuple[DecayLine, ...],
    *,
    begin: float = 0.0,
    bent: bool = False,
    law: Law | None = None,
) -> Array:
    """Linear columns of the waveform: offset, drift, ring, lines, and what bends it; shape (n, p)."""
    decay, w = vector[:2]
    unit = Dynamics("AF", 1.0, w**2 + decay**2, max(2 * decay, 0.0))
    span = time[-1] - time[0] or 1.0
    columns = [np.ones(time.size), (time - time[0]) / span - 0.5]
    rest = 2
    instant, duration = begin, 0.0
    if shape == "free":
        columns += _ringing(time - begin, decay, w) if law is None else _by_law(time - begin, vector, law)
    else:
        instant, rest = vector[2], 3
        duration = abs(vector[3]) if shape == "ramp" else 0.0
        rest += shape == "ramp"
        released = _released(unit, time - instant, duration)
        if law is not None:
            rung = time > instant + duration
            cosine, sine = _by_law(time[rung] - instant - duration, vector, law)
            edge = np.array([-1e-3, 1e-3]) / w + duration
            near = _released(unit, edge, duration)
            at = float(_released(unit, np.array([duration]), duration)[0])
            rate = 0.0 if duration <= 0 else float(near[1] - near[0]) * w / 2e-3
            released[rung] = at * cosine + (rate + decay * at) / w * sine
        columns.append(released)
    since = np.maximum(time - instant, 0.0)
    for line in lines:
        frequency, rest = vector[rest], rest + 1
        if line.decay == 0:
            columns += _ringing(time - time[0], 0.0, frequency)
            continue
        fall, rest = abs(vector[rest]), rest + 1
        if shape == "free":
            columns += _ringing(since, fall, frequency)
        else:  # a mode of its own, released together with the first
            mode = Dynamics("AF", 1.0, frequency**2 + fall**2, 2 * fall)
            columns.append(_released(mode, time - instant, duration))
    if bent:
        columns += _bending(time - instant - duration, decay, w)
    return np.array(columns).T


def _released(mode: Dynamics, since: Array, duration: float) -> Array:
    """Balance load after a release, over the load held before, shape (n,) [1]."""
    return mode.free_decay(since) if duration <= 0 else 1 - mode.step_response(since, duration=duration)


def envelope_of(since: Array, decay: float, share: float, power: int) -> Array:
    """Amplitude over its first value, where it falls as a (1 - s + s A^n) says [1], shape (n,).

    The equation is Bernoulli's: A^-n follows a straight line and an exponential.
    """
    fall = power * decay * (1 - share) * since
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        grown = np.where(np.abs(fall) < 1e-8, 1 + fall / 2, np.expm1(np.minimum(fall, 600.0)) / fall)
    inverse = np.maximum(1 + power * decay * since * grown, 0.0 if power < 0 else 1e-300)
    # a trial may rise until it is infinite: its square is still to be a number
    return np.asarray(np.minimum(inverse ** (-1 / power), np.exp(STEEPEST_RISE)))


def _by_law(since: Array, vector: Array, law: Law) -> list[Array]:
    """Cosine and sine of an oscillation that begins with amplitude 1 and falls by a law, shape (n,) each [1]."""
    (decay, w), (share, stiffer) = vector[:2], vector[-2:]
    size = envelope_of(since, decay, share, law.damping)
    power = size**law.frequency
    over = np.concatenate(([since[0] * (1 + power[0]) / 2], np.diff(since) * (power[1:] + power[:-1]) / 2))
    phase = w * (since + stiffer * np.cumsum(over))
    return [size * np.cos(phase), size * np.sin(phase)]


def _bending(since: Array, decay: float, w: float) -> list[Array]:
    """Change of a ringing of amplitude 1 when decay rate and frequency rise with its envelope, relative, shape (n,).

    With a(t) = a (1 + e A(t)), A the envelope over its first value, the amplitude falls as exp(-a t - e (1 - A)) and,
    likewise, the phase runs ahead by d (w / a) (1 - A); both to first order.
    """
    decay = max(decay, 1e-6 * abs(w))  # what does not fall does not bend
    ringing = exponentials(complex(-decay, w), since)
    ringing *= 1 - exponentials(complex(-decay, 0), since).real
    return [-ringing.real, -w / decay * ringing.imag]


def _ringing(since: Array, decay: float, w: float) -> list[Array]:
    """Cosine and sine of an oscillation that begins with amplitude 1 and falls, shape (n,) each [1]."""
    rise = STEEPEST_RISE / max(float(since[-1]), 1e-300)
    if -decay > rise:
        fall = np.exp(np.minimum(-decay * since, STEEPEST_RISE))
        return [fall * np.cos(w * since), fall * np.sin(w * since)]
    ringing = exponentials(complex(-decay, w), since)
    return [ringing.real, ringing.imag]


def projected(columns: Array, values: Array) -> tuple[Array, Array]:
    """Sizes of the columns, shape (p,) or (p, c), and residuals of values, shape (n,) or (n, c)."""
    scale = np.sqrt(np.einsum("np,np->p", columns, columns))
    scale[scale == 0] = 1.0
    unit = columns / scale
    square = unit.T @ unit
    try:
        factor = cho_factor(square)
    except LinAlgError:
        factor = None
    if factor is None or float(np.min(np.diag(factor[0]))) < ALIKE:
        sizes: Array = lstsq(columns, values, lapack_driver="gelsy", check_finite=False)[0]
        return sizes, values - columns @ sizes
    found = cho_solve(factor, unit.T @ values)
    left = values - unit @ found
    more = cho_solve(factor, unit.T @ left)  # once more, for what rounding in the normal equations has lost
    found, left = found + more, left - unit @ more
    return found / (scale if values.ndim == 1 else scale[:, None]), left


def jacobian(
    time: Array,
    shape: Shape,
    vector: Array,
    lines: tuple[DecayLine, ...],
    *,
    begin: float,
    scale: Array,
    sizes: Array,
    bent: bool,
    law: Law | None = None,
) -> Array:
    """Derivatives of the waveform by the nonlinear and the linear parameters, shape (n, p)."""
    slopes = []
    for k, step in enumerate(1e-3 * scale):
        shift = np.zeros(vector.size)
        shift[k] = step
        late, early = (
            columns_of(time, shape, vector + sign * shift, lines, begin=begin, bent=bent, law=law) for sign in (1, -1)
        )
        slopes.append(((late - early) @ sizes) / (2 * step))
    return np.column_stack([*slopes, columns_of(time, shape, vector, lines, begin=begin, bent=bent, law=law)])


def ring_up_to(ring: Ring) -> float:
    """Time for which the ringing stands above the noise of its samples, within the window [s]."""
    noise = float(np.sqrt(ring.variance))
    length = float(ring.time[-1]) - ring.start
    if ring.decay <= 0 or ring.amplitude <= noise:
        return length if ring.amplitude > noise else 0.0
    return min(float(np.log(ring.amplitude / noise)) / ring.decay, length)
