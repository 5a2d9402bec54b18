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

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, lstsq
from scipy.optimize import least_squares

from aerobalance.dynamics.modal import exponentials
from aerobalance.dynamics.single import Dynamics
from aerobalance.identification.free_decay.event import Look, Shape
from aerobalance.recording.channel import Array

HEAVIEST: Final = 0.3
"""Damping ratio above which a further line or mode is none but the misfit of something else."""

TAPPED: Final = 0.5
"""Change of level over amplitude of the ringing below which it was set off by a blow and not by a release."""

STEEPEST_RISE: Final = 50.0
"""Logarithm of the growth at which a rising trial waveform is cut, so that numbers stay finite."""

SLOPE_STEP: Final = 1e-5
"""Change of a parameter, over its scale in the search, over which slopes are taken."""

ALIKE: Final = 1e-4
"""Part of a column's size that no other column shows, below which the normal equations are too poor."""

EVIDENCE: Final = 20.0
"""Drop in the sum of squares over the noise variance that a richer shape must bring."""


SIGN: Final = 4.0
"""Such a drop to first order, for which a duration of the release is fitted: chance gives as much one time in 20."""


COARSE: Final = 32.0
"""Means in a period of the ringing that suffice to begin with."""


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
        line its angular frequency and, where it decays, its decay rate.
    covariance
        Of `vector` and `sizes`, in this order.
    colour
        Spectrum of the residuals near the ring over that of white noise, 1 where the residuals pass as white.
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


def fit_ring(
    time: Array, values: Array, start: Look | Ring, *, lines: tuple[DecayLine, ...] = (), bent: bool | None = None
) -> Ring:
    """Fit the waveform from a first look, or again from an earlier fit with other lines or another window.

    A release at once is tried first, and one over a duration where that explains the record better. An earlier fit
    says whether the waveform is bent, unless that is given.
    """
    if bent is None:
        bent = isinstance(start, Ring) and start.bent
    begun = _approach(time, values, start) if isinstance(start, Look) else start
    if begun.shape == "free":
        part = time >= begun.start
        return _search(time[part], values[part], "free", start=begun, lines=lines, bent=bent)
    sharp = _search(time, values, "release", start=begun, lines=lines, bent=bent)
    if _gain_of_a_duration(sharp) < SIGN * sharp.variance:
        return sharp
    ramp = _search(time, values, "ramp", start=sharp, lines=lines, bent=bent)
    return ramp if sharp.squares - ramp.squares > EVIDENCE * ramp.variance else sharp


def _gain_of_a_duration(ring: Ring) -> float:
    """By how much the squares of a release at once fall, to first order, if it may take a short time [N^2].

    Over a duration d the ringing is as that from its middle on, but weaker by (w d)^2 / 24: the square of the duration
    acts as a linear parameter. However long it is, the ringing is weaker, so that this shows.
    """
    duration = 1 / ring.rate
    middle = np.concatenate([ring.vector[:2], [ring.start - duration / 2, duration], ring.vector[3:]])
    begin, scale = float(ring.time[0]), _scale(ring, "release", ring.vector.size)
    J = _jacobian(
        ring.time, "release", ring.vector, ring.lines, begin=begin, scale=scale, sizes=ring.sizes, bent=ring.bent
    )
    slower = _columns(ring.time, "ramp", middle, ring.lines, begin=begin, bent=ring.bent) @ ring.sizes
    change = slower - ring.values + ring.residuals
    change = projected(J, change)[1]
    square = float(change @ change)
    return float(change @ ring.residuals) ** 2 / square if square > 0 else 0.0


def _approach(time: Array, values: Array, look: Look) -> Ring:
    """Fit a few periods first, where a poor frequency does no harm, then three times as many, and so on to the end."""
    begun: Look | Ring = _placed(time, values, look) if look.shape == "release" else look
    reach = 4 / look.frequency
    while True:
        near = (time > begun.start - 3 * reach) & (time < begun.start + reach)
        last = begun.start + reach > time[-1]
        if near.sum() > 16:
            shape: Shape = "release" if look.shape == "release" else "free"
            part = (time[near], values[near])
            begun = _search(*(part if last else _coarse(*part, begun)), shape, start=begun, lines=())
        if last:
            break
        reach *= 3
    ring = begun if isinstance(begun, Ring) else _search(time, values, look.shape, start=begun, lines=())
    if ring.shape == "free":
        return ring
    after = ring.time > look.start + 0.5 / look.frequency
    if after.sum() < 32:
        return ring
    tapped = _search(ring.time[after], ring.values[after], "free", start=ring, lines=())
    before = time < look.start - 1 / look.frequency
    height = abs(float(values[before].mean() - tapped.values.mean())) if before.any() else 0.0
    with np.errstate(over="ignore"):  # a short record can leave a decay so steep that nothing stood before it
        swing = tapped.amplitude * float(np.exp(tapped.decay * (tapped.start - look.start)))
    misfit = float(np.mean(ring.residuals[after] ** 2)) > 2 * tapped.variance
    return tapped if misfit and height < TAPPED * swing else ring


def freed(ring: Ring) -> Ring:
    """The ring itself, or a free one in its place where a release from rest does not explain what follows it."""
    after = ring.time >= ring.start + ring.duration + 0.5 / ring.frequency
    if ring.shape == "free" or np.count_nonzero(after) < 8 * (3 + len(ring.lines)):
        return ring
    free = _search(ring.time[after], ring.values[after], "free", start=ring, lines=ring.lines, bent=ring.bent)
    resolution = (1e-9 * ring.amplitude) ** 2 * free.time.size
    allowed = (EVIDENCE + 3 * np.log(free.time.size)) * free.variance + resolution
    return ring if float(np.sum(ring.residuals[after] ** 2)) < free.squares + allowed else free


def _coarse(time: Array, values: Array, start: Look | Ring) -> tuple[Array, Array]:
    """Means of times and readings over a small part of a period, which serve to begin with."""
    count = int(start.rate / (COARSE * start.frequency))
    whole = time.size - time.size % count if count > 1 else 0
    if whole < 16 * count or count < 2:
        return time, values
    instants, readings = (np.mean(each[:whole].reshape(-1, count), axis=1) for each in (time, values))
    return instants, readings


def _placed(time: Array, values: Array, look: Look) -> Look:
    """The first look with its instant moved to where the waveform fits best, within four periods either side."""
    part = (time > look.start - 10 / look.frequency) & (time < look.start + 20 / look.frequency)
    best, squares = look, np.inf
    instants, readings = _coarse(time[part], values[part], look)
    for shift in np.arange(-4, 4, 1 / 16) / look.frequency:
        trial = replace(look, start=look.start + shift)
        left = projected(_columns(instants, "release", _start_vector(trial, "release", ()), ()), readings)[1]
        if left @ left < squares:
            best, squares = trial, float(left @ left)
    return best


def _start_vector(start: Look | Ring, shape: Shape, lines: tuple[DecayLine, ...]) -> Array:
    vector = [start.decay, 2 * np.pi * start.frequency]
    if shape != "free":
        vector.append(start.start)
    if shape == "ramp":
        vector.append(max(start.duration if isinstance(start, Ring) else 0.0, 1.0 / start.rate))
    for line in lines:
        vector.append(2 * np.pi * line.frequency)
        if line.decay > 0:
            vector.append(line.decay)
    return np.array(vector)


def _columns(
    time: Array, shape: Shape, vector: Array, lines: tuple[DecayLine, ...], *, begin: float = 0.0, bent: bool = False
) -> Array:
    """Linear columns of the waveform: offset, drift, ring, lines, and what bends it; shape (n, p)."""
    decay, w = vector[:2]
    unit = Dynamics("AF", 1.0, w**2 + decay**2, max(2 * decay, 0.0))
    span = time[-1] - time[0] or 1.0
    columns = [np.ones(time.size), (time - time[0]) / span - 0.5]
    rest = 2
    instant, duration = begin, 0.0
    if shape == "free":
        columns += _ringing(time - begin, decay, w)
    else:
        instant, rest = vector[2], 3
        duration = abs(vector[3]) if shape == "ramp" else 0.0
        rest += shape == "ramp"
        columns.append(_released(unit, time - instant, duration))
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


def _scale(start: Look | Ring, shape: Shape, size: int) -> Array:
    """Steps of the search in each nonlinear parameter, shape (size,)."""
    scale = np.full(size, 0.01 * start.decay + 1e-6 * start.frequency)
    scale[0] = max(0.1 * start.decay, 1e-6 * start.frequency)
    if shape != "free":
        scale[2 : 3 + (shape == "ramp")] = 0.1 / start.rate
    return scale


def _search(
    time: Array, values: Array, shape: Shape, *, start: Look | Ring, lines: tuple[DecayLine, ...], bent: bool = False
) -> Ring:
    """Least squares over the nonlinear parameters of one shape."""
    begin = float(time[0])
    origin = _start_vector(start, shape, lines)
    scale = _scale(start, shape, origin.size)

    def columns_at(moved: Array) -> Array:
        return _columns(time, shape, origin + scale * moved, lines, begin=begin, bent=bent)

    def residuals(moved: Array) -> Array:
        return projected(columns_at(moved), values)[1]

    def slopes(moved: Array) -> Array:
        """Slopes of the residuals; the change of the projection itself is left out [Kaufman1975]_."""
        columns = columns_at(moved)
        sizes, _ = projected(columns, values)
        steps = SLOPE_STEP * np.eye(moved.size)
        changes = np.column_stack([(columns_at(moved + step) - columns) @ sizes for step in steps]) / SLOPE_STEP
        return -projected(columns, changes)[1]

    found = least_squares(residuals, np.zeros(origin.size), slopes, method="lm", xtol=1e-12, ftol=1e-12, max_nfev=150)
    vector = origin + scale * found.x
    sizes, left = projected(columns_at(found.x), values)
    J = _jacobian(time, shape, vector, lines, begin=begin, scale=scale, sizes=sizes, bent=bent)
    covariance, colour = _covariance(J, left, time=time, frequency=float(vector[1]) / (2 * np.pi), sizes=sizes)
    place = 2 + (shape != "free") + (shape == "ramp")
    fitted = []
    for line in lines:
        decay = abs(float(vector[place + 1])) if line.decay > 0 else 0.0
        fitted.append(DecayLine(float(vector[place]) / (2 * np.pi), decay))
        place += 1 + (line.decay > 0)
    return Ring(
        shape=shape,
        frequency=float(vector[1]) / (2 * np.pi),
        decay=float(vector[0]),
        start=begin if shape == "free" else float(vector[2]),
        duration=abs(float(vector[3])) if shape == "ramp" else 0.0,
        lines=tuple(fitted),
        bent=bent,
        vector=vector,
        sizes=sizes,
        covariance=covariance,
        colour=colour,
        time=time,
        values=values,
        residuals=left,
        rate=start.rate,
    )


def _jacobian(
    time: Array,
    shape: Shape,
    vector: Array,
    lines: tuple[DecayLine, ...],
    *,
    begin: float,
    scale: Array,
    sizes: Array,
    bent: bool,
) -> Array:
    """Derivatives of the waveform by the nonlinear and the linear parameters, shape (n, p)."""
    slopes = []
    for k, step in enumerate(1e-3 * scale):
        shift = np.zeros(vector.size)
        shift[k] = step
        late, early = (_columns(time, shape, vector + sign * shift, lines, begin=begin, bent=bent) for sign in (1, -1))
        slopes.append(((late - early) @ sizes) / (2 * step))
    return np.column_stack([*slopes, _columns(time, shape, vector, lines, begin=begin, bent=bent)])


def _covariance(J: Array, left: Array, *, time: Array, frequency: float, sizes: Array) -> tuple[Array, float]:
    """Covariance of the nonlinear and the linear parameters, and the colour of the residuals."""
    size = np.sqrt(np.sum(J**2, axis=0))
    size[size == 0] = 1.0
    inverse = np.linalg.pinv((J / size).T @ (J / size), hermitian=True) / np.outer(size, size)
    variance = float(left @ left) / max(left.size - J.shape[1], 1)
    rounding = variance < (1e-9 * float(np.abs(sizes[2:]).max())) ** 2
    colour = 1.0 if rounding else _colour(left, frequency, time)
    return inverse * variance * colour, colour


def _colour(left: Array, frequency: float, time: Array) -> float:
    """Residual spectrum around a frequency over that of white noise of the same variance, where significantly more.

    The band holds enough ordinates for the chance excess to be small; a value within it counts as white.
    """
    power = np.abs(np.fft.rfft(left - left.mean())) ** 2
    ordinates = power[1:-1] / max(float(power[1:-1].mean()), 1e-300)
    place = round(frequency * (time[-1] - time[0]))
    reach = max(12, place // 8)
    band = ordinates[max(place - reach, 0) : place + reach + 1]
    if band.size < 12:
        return 1.0
    level = float(band.mean())
    return level if level > 1 + 4 / np.sqrt(band.size) else 1.0


def ring_up_to(ring: Ring) -> float:
    """Time for which the ringing stands above the noise of its samples, within the window [s]."""
    noise = float(np.sqrt(ring.variance))
    length = float(ring.time[-1]) - ring.start
    if ring.decay <= 0 or ring.amplitude <= noise:
        return length if ring.amplitude > noise else 0.0
    return min(float(np.log(ring.amplitude / noise)) / ring.decay, length)
