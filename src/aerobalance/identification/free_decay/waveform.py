"""Model of the free decay of a balance load after a release, for a fit by separable nonlinear least squares.

Decay rate, frequency, instant and duration of the release and the frequencies of further lines are the nonlinear
parameters; offset, drift, height of the release and all amplitudes are linear, and for given nonlinear parameters they
follow from a linear least-squares fit (variable projection [Golub1973]_).

References
----------
.. [Golub1973] G. H. Golub, V. Pereyra, "The differentiation of pseudo-inverses and nonlinear least squares problems
   whose variables separate", SIAM J. Numer. Anal. 10 (1973) 413.
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
"""Damping ratio above which a further line or mode is not believed, as it fits some other error of the model.

It would fall to exp(-2 pi 0.3 / sqrt(1 - 0.3^2)) = 14 % within one period, which hardly is an oscillation.
"""

STEEPEST_RISE: Final = 50.0
"""Exponent at which a growing trial waveform (negative decay rate) is cut, so that numbers stay finite."""

ALIKE: Final = 1e-4
"""Part of a column's norm that is independent of the columns before it, below which QR takes the place of the normal
equations: they square it, and with 1e-8 of it half of the 16 digits are lost."""


@dataclass(frozen=True, slots=True)
class DecayLine:
    """A further spectral line in the record of a free decay: steady (hum, decay 0) or another mode.

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
    """Nonlinear damping and stiffness: change of decay rate and frequency in proportion to a power of the amplitude.

    With A the amplitude over that at the start of the free decay the decay rate is a (1 - s + s A^n) and the angular
    frequency w (1 + k A^m): n = -1 is dry friction beside viscous damping, 1 a drag that grows with the square of the
    velocity; 2 is a cubic damper or spring.

    Attributes
    ----------
    damping, frequency
        The powers n and m.
    """

    damping: int
    frequency: int


NO_FORCE: Final = 0.1
"""What a force makes of the readings at resonance, over their noise there, up to which it is none."""


@dataclass(frozen=True, slots=True, eq=False)
class DrivingForce:
    """A random force that acts on the balance during the free decay.

    Attributes
    ----------
    density
        Two-sided power spectral density of the force near the natural frequency [N^2/Hz].
    band
        Frequencies between which the density was estimated [Hz].
    objective
        Negative logarithm of the likelihood.
    over_noise
        What the force makes of the readings at resonance, over their noise there, as powers [1].
    parameters, centre
        The estimated parameters, and the mean of their prior, shape (3,) each: logarithm of the density of the
        readings' noise, logarithm of `density`, and change of the latter from the middle of the band to its end.
    """

    density: float
    band: tuple[float, float]
    objective: float
    over_noise: float
    parameters: Array
    centre: Array

    @property
    def acts(self) -> bool:
        """Whether it is more than nothing beside the noise of the readings."""
        return self.over_noise > NO_FORCE

    @property
    def colour(self) -> float:
        """Noise of the readings near the ringing over their white noise, as powers [1]."""
        return float(np.exp(self.parameters[0] - self.centre[0]))


@dataclass(frozen=True, slots=True, eq=False)
class Ring:
    """A fitted free decay.

    Attributes
    ----------
    shape
        ``"release"``: load held and let go at once. ``"ramp"``: let go over a duration. ``"free"``: the decay alone,
        of any amplitude and phase.
    frequency, decay
        Damped frequency [Hz] and decay rate [1/s].
    start, duration
        Instant of the release, or of the first sample used for ``"free"`` [s], and its duration [s].
    lines
        Further lines.
    bent
        Whether decay rate and frequency may change with the envelope, to first order.
    vector
        Nonlinear parameters: decay rate, damped angular frequency, instant and duration where fitted, and for each
        line its angular frequency and, where it decays, its decay rate; last s and k of the law where there is one.
    sizes
        Linear parameters: offset, drift, height (free: amplitudes of cosine and sine), amplitudes of the lines; and
        where `bent` the relative change of decay rate and of frequency with the envelope, each times the height.
    covariance
        Covariance of `vector` and `sizes`, in this order.
    colour
        Power spectral density of the residuals near the natural frequency over that of white noise of their variance;
        1 where they pass as white [1].
    time, values
        Instants [s] and readings [N] of the window that was fitted, shape (n,) each.
    residuals
        Readings less model, shape (n,) [N]; where there is a driving force, innovations scaled to the deviation of the
        noise.
    rate
        Sampling rate [Hz].
    force
        Random force that acts throughout; None where the readings show none.
    law
        Law by which decay rate and frequency change with the amplitude, `decay` and `frequency` being those at the
        start; None where they are constant.
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
        """Number of samples less number of parameters."""
        return self.time.size - self.vector.size - self.sizes.size

    @property
    def variance(self) -> float:
        """Variance of the residuals [N^2]."""
        return self.squares / max(self.degrees_of_freedom, 1)

    @property
    def height(self) -> float:
        """Load before the release less the load after [N]; 0 where the shape is ``"free"``."""
        return 0.0 if self.shape == "free" else float(self.sizes[2])

    @property
    def amplitude(self) -> float:
        """Amplitude of the oscillation at its start [N]."""
        return abs(self.height) if self.shape != "free" else float(np.hypot(self.sizes[2], self.sizes[3]))

    def line_sizes(self) -> list[float]:
        """Amplitude of every further line [N]."""
        return [float(np.linalg.norm(self.sizes[self._size_places(number)])) for number in range(len(self.lines))]

    def modes(self) -> tuple[Array, Array]:
        """Decay rate, damped angular frequency and height of the first mode and, after a release, of further modes.

        Returns
        -------
        values
            Shape (m, 3) [1/s, rad/s, N]; heights have signs. The shape ``"free"`` has no height: 1 stands for it.
        slopes
            Derivatives of `values` by the parameters that `covariance` is of, shape (m, 3, p).
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
        """Indices of a line's amplitudes in `sizes`."""
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
    """Return the design matrix of the linear parameters `Ring.sizes`, shape (n, p).

    Parameters
    ----------
    time
        Sampling instants, shape (n,) [s].
    shape, vector, lines, bent, law
        As in `Ring`.
    begin
        Start of the decay where `shape` is ``"free"`` [s]; else it is in `vector`.
    """
    decay, w = vector[:2]
    # Only the ratio of the loads counts, so any component of mass 1 with the same pole will do.
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
        if law is None:
            columns.append(_released(unit, time - instant, duration))
        else:
            columns.append(_released_by_law(unit, time, vector, law, instant=instant, duration=duration))
    since = np.maximum(time - instant, 0.0)
    for line in lines:
        frequency, rest = vector[rest], rest + 1
        if line.decay == 0:
            columns += _ringing(time - time[0], 0.0, frequency)
            continue
        own_decay, rest = abs(vector[rest]), rest + 1
        if shape == "free":
            columns += _ringing(since, own_decay, frequency)
        else:  # another mode, released together with the first
            mode = Dynamics("AF", 1.0, frequency**2 + own_decay**2, 2 * own_decay)
            columns.append(_released(mode, time - instant, duration))
    if bent:
        columns += _bending(time - instant - duration, decay, w)
    return np.array(columns).T


def _released(mode: Dynamics, since: Array, duration: float) -> Array:
    """Return the balance load after a release, over the load held before, shape (n,) [1]."""
    return mode.free_decay(since) if duration <= 0 else 1 - mode.step_response(since, duration=duration)


def _released_by_law(
    mode: Dynamics, time: Array, vector: Array, law: Law, *, instant: float, duration: float
) -> Array:
    """Return the same where decay rate and frequency follow a law once the release is over, shape (n,) [1].

    The decay by the law takes over with the load and the slope that the linear mode has at the end of the release.
    """
    decay, w = vector[:2]
    load = _released(mode, time - instant, duration)
    over = time > instant + duration
    cosine, sine = _by_law(time[over] - instant - duration, vector, law)
    step = 1e-3  # of phase [rad], for a central difference
    before, after = _released(mode, np.array([-step, step]) / w + duration, duration)
    at = float(_released(mode, np.array([duration]), duration)[0])
    slope = 0.0 if duration <= 0 else float(after - before) * w / (2 * step)
    load[over] = at * cosine + (slope + decay * at) / w * sine
    return load


def envelope_of(since: Array, decay: float, share: float, power: int) -> Array:
    """Return the amplitude A over its first value, with the decay rate a (1 - s + s A^n), shape (n,) [1].

    A' = -a A (1 - s + s A^n) is a Bernoulli equation: linear in A^-n, hence solved by an exponential.
    """
    fall = power * decay * (1 - share) * since
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        grown = np.where(np.abs(fall) < 1e-8, 1 + fall / 2, np.expm1(np.minimum(fall, 600.0)) / fall)
    inverse = np.maximum(1 + power * decay * since * grown, 0.0 if power < 0 else 1e-300)
    # a trial may rise until it is infinite: its square is still to be a number
    return np.asarray(np.minimum(inverse ** (-1 / power), np.exp(STEEPEST_RISE)))


def _by_law(since: Array, vector: Array, law: Law) -> list[Array]:
    """Return cosine and sine of an oscillation of amplitude 1 at first that decays by a law, shape (n,) each [1]."""
    (decay, w), (share, stiffer) = vector[:2], vector[-2:]
    size = envelope_of(since, decay, share, law.damping)
    power = size**law.frequency
    # Integral of the power over time by the trapezoidal rule, from the start, where the power is 1.
    over = np.concatenate(([since[0] * (1 + power[0]) / 2], np.diff(since) * (power[1:] + power[:-1]) / 2))
    phase = w * (since + stiffer * np.cumsum(over))
    return [size * np.cos(phase), size * np.sin(phase)]


def _bending(since: Array, decay: float, w: float) -> list[Array]:
    """Return the derivatives of a decay of amplitude 1 by e and d, at e = d = 0, shape (n,) each [1].

    With the decay rate a (1 + e A) and the angular frequency w (1 + d A), A the envelope over its first value, the
    amplitude falls as exp(-a t - e (1 - A)) and the phase runs ahead by d (w / a) (1 - A), both to first order.
    """
    decay = max(decay, 1e-6 * abs(w))  # keeps w / a finite
    ringing = exponentials(complex(-decay, w), since)
    ringing *= 1 - exponentials(complex(-decay, 0), since).real
    return [-ringing.real, -w / decay * ringing.imag]


def _ringing(since: Array, decay: float, w: float) -> list[Array]:
    """Return cosine and sine of an oscillation of amplitude 1 at first that decays, shape (n,) each [1]."""
    steepest = STEEPEST_RISE / max(float(since[-1]), 1e-300)
    if -decay > steepest:
        growth = np.exp(np.minimum(-decay * since, STEEPEST_RISE))
        return [growth * np.cos(w * since), growth * np.sin(w * since)]
    ringing = exponentials(complex(-decay, w), since)
    return [ringing.real, ringing.imag]


def projected(columns: Array, values: Array) -> tuple[Array, Array]:
    """Return the least-squares linear parameters, shape (p,) or (p, c), and the residuals, shape (n,) or (n, c)."""
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
    more = cho_solve(factor, unit.T @ left)  # iterative refinement, against rounding in the normal equations
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
    """Return the derivatives of the model by the nonlinear and the linear parameters, shape (n, p).

    Those by the nonlinear ones are central differences over a thousandth of the `scale` of each.
    """
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
    """Return the time for which the amplitude exceeds the noise of one sample, within the window [s]."""
    noise = float(np.sqrt(ring.variance))
    length = float(ring.time[-1]) - ring.start
    if ring.decay <= 0 or ring.amplitude <= noise:
        return length if ring.amplitude > noise else 0.0
    return min(float(np.log(ring.amplitude / noise)) / ring.decay, length)
