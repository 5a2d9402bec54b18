"""The fit of a ringing load's waveform to its readings.

Decay rate, frequency, instant and duration of the release and the frequencies of further lines are searched; all else
is linear and follows from them (variable projection [Golub1973]_, with the slopes of [Kaufman1975]_).

References
----------
.. [Golub1973] G. H. Golub, V. Pereyra, "The differentiation of pseudo-inverses and nonlinear least squares problems
   whose variables separate", SIAM J. Numer. Anal. 10 (1973) 413.
.. [Kaufman1975] L. Kaufman, "A variable projection method for solving separable nonlinear least squares problems", BIT
   15 (1975) 49.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from aerobalance.identification.free_decay.event import Look, Shape
from aerobalance.identification.free_decay.waveform import DecayLine, Law, Ring, columns_of, jacobian, projected
from aerobalance.recording.channel import Array

TAPPED: Final = 0.5
"""Change of level over amplitude of the ringing below which it was set off by a blow and not by a release."""

SLOPE_STEP: Final = 1e-5
"""Change of a parameter, over its scale in the search, over which slopes are taken."""

EVIDENCE: Final = 20.0
"""Drop in the sum of squares over the noise variance that a richer shape must bring."""

SIGN: Final = 4.0
"""Such a drop to first order, for which a duration of the release is fitted: chance gives as much one time in 20."""

COARSE: Final = 32.0
"""Means in a period of the ringing that suffice to begin with."""

EARLY: Final = 6.0
"""Periods after the first reading in which a release is looked for by its waveform, as no onset is seen there."""

AFTER: Final = 3.0
"""Periods after such a release that are looked at."""

CLEARLY_RELEASED: Final = 0.5
"""Squares that such a release leaves, over those of a ringing from the first reading on, below which it is taken."""


def fit_ring(
    time: Array,
    values: Array,
    start: Look | Ring,
    *,
    lines: tuple[DecayLine, ...] = (),
    bent: bool | None = None,
    law: Law | None = None,
) -> Ring:
    """Fit the waveform from a first look, or again from an earlier fit with other lines or another window.

    A release at once is tried first, and one over a duration where that explains the record better. An earlier fit
    says whether the waveform is bent and by which law, unless that is given.
    """
    if law is None and bent is None and isinstance(start, Ring):
        law = start.law
    if bent is None:
        bent = isinstance(start, Ring) and start.bent
    begun = _approach(time, values, start) if isinstance(start, Look) else start
    if begun.shape == "free":
        part = time >= begun.start
        return _search(time[part], values[part], "free", start=begun, lines=lines, bent=bent, law=law)
    sharp = _search(time, values, "release", start=begun, lines=lines, bent=bent, law=law)
    if _gain_of_a_duration(sharp) < SIGN * sharp.variance:
        return sharp
    ramp = _search(time, values, "ramp", start=sharp, lines=lines, bent=bent, law=law)
    return ramp if sharp.squares - ramp.squares > EVIDENCE * ramp.variance else sharp


def _gain_of_a_duration(ring: Ring) -> float:
    """By how much the squares of a release at once fall, to first order, if it may take a short time [N^2].

    Over a duration d the ringing is as that from its middle on, but weaker by (w d)^2 / 24: the square of the duration
    acts as a linear parameter. However long it is, the ringing is weaker, so that this shows.
    """
    duration = 1 / ring.rate
    middle = np.concatenate([ring.vector[:2], [ring.start - duration / 2, duration], ring.vector[3:]])
    begin, scale = float(ring.time[0]), _scale(ring, "release", ring.vector.size)
    J = jacobian(
        ring.time,
        "release",
        ring.vector,
        ring.lines,
        begin=begin,
        scale=scale,
        sizes=ring.sizes,
        bent=ring.bent,
        law=ring.law,
    )
    slower = columns_of(ring.time, "ramp", middle, ring.lines, begin=begin, bent=ring.bent, law=ring.law) @ ring.sizes
    change = slower - ring.values + ring.residuals
    change = projected(J, change)[1]
    square = float(change @ change)
    return float(change @ ring.residuals) ** 2 / square if square > 0 else 0.0


def _approach(time: Array, values: Array, look: Look) -> Ring:
    """Fit a few periods first, where a poor frequency does no harm, then three times as many, and so on to the end."""
    if look.shape == "free":
        look = _early(time, values, look)
    begun: Look | Ring = _placed(time, values, look) if look.shape == "release" else look
    reach = 4 / look.frequency
    while True:
        near = (time > begun.start - 3 * reach) & (time < begun.start + reach)
        last = begun.start + reach > time[-1]
        if near.sum() > 16:
            shape: Shape = "release" if look.shape == "release" else "free"
            part = (time[near], values[near])
            begun = _search(*(part if last else _coarse(*part, begun)), shape, start=begun, lines=())
            if begun.decay <= 0 and not last:  # by chance, in a few periods that are hardly more than noise
                begun = replace(begun, decay=look.decay, frequency=look.frequency, start=look.start)
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
    poor = float(np.mean(ring.residuals[after] ** 2)) > 2 * tapped.variance
    return tapped if poor and height < TAPPED * swing else ring


def freed(ring: Ring) -> Ring:
    """The ring itself, or a free one in its place where a release from rest does not explain what follows it."""
    after = ring.time >= ring.start + ring.duration + 0.5 / ring.frequency
    if ring.shape == "free" or np.count_nonzero(after) < 8 * (3 + len(ring.lines)):
        return ring
    free = _search(
        ring.time[after], ring.values[after], "free", start=ring, lines=ring.lines, bent=ring.bent, law=ring.law
    )
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


def _early(time: Array, values: Array, look: Look) -> Look:
    """The first look, or a release in the first periods where that explains what is around it and a ringing does not.

    A ringing from the first reading on has the better fit where the record begins amid it, and none to speak of where
    a load is held first.
    """
    period, begin = 1 / look.frequency, float(time[0])
    part = time < begin + (EARLY + AFTER) * period
    instants, readings = _coarse(time[part], values[part], look)
    best, least = look, CLEARLY_RELEASED
    for shift in np.arange(0, EARLY, 1 / 16) * period:
        trial = replace(look, shape="release", start=begin + shift)
        near = instants < trial.start + AFTER * period  # over which a poor frequency does no harm
        squares = []
        for one in (trial, look):
            columns = columns_of(instants[near], one.shape, _start_vector(one, one.shape, ()), (), begin=begin)
            left = projected(columns, readings[near])[1]
            squares.append(float(left @ left))
        if squares[0] < least * squares[1]:
            best, least = trial, squares[0] / squares[1]
    return best


def _placed(time: Array, values: Array, look: Look) -> Look:
    """The first look with its instant moved to where the waveform fits best, within four periods either side."""
    part = (time > look.start - 10 / look.frequency) & (time < look.start + 20 / look.frequency)
    best, squares = look, np.inf
    instants, readings = _coarse(time[part], values[part], look)
    for shift in np.arange(-4, 4, 1 / 16) / look.frequency:
        trial = replace(look, start=look.start + shift)
        left = projected(columns_of(instants, "release", _start_vector(trial, "release", ()), ()), readings)[1]
        if left @ left < squares:
            best, squares = trial, float(left @ left)
    return best


def _start_vector(start: Look | Ring, shape: Shape, lines: tuple[DecayLine, ...], law: Law | None = None) -> Array:
    vector = [start.decay, 2 * np.pi * start.frequency]
    if shape != "free":
        vector.append(start.start)
    if shape == "ramp":
        vector.append(max(start.duration if isinstance(start, Ring) else 0.0, 1.0 / start.rate))
    for line in lines:
        vector.append(2 * np.pi * line.frequency)
        if line.decay > 0:
            vector.append(line.decay)
    if law is not None:
        vector += start.vector[-2:].tolist() if isinstance(start, Ring) and start.law is not None else [0.0, 0.0]
    return np.array(vector)


def _scale(start: Look | Ring, shape: Shape, size: int) -> Array:
    """Steps of the search in each nonlinear parameter, shape (size,)."""
    scale = np.full(size, 0.01 * start.decay + 1e-6 * start.frequency)
    scale[0] = max(0.1 * start.decay, 1e-6 * start.frequency)
    if shape != "free":
        scale[2 : 3 + (shape == "ramp")] = 0.1 / start.rate
    return scale


def _search(
    time: Array,
    values: Array,
    shape: Shape,
    *,
    start: Look | Ring,
    lines: tuple[DecayLine, ...],
    bent: bool = False,
    law: Law | None = None,
) -> Ring:
    """Least squares over the nonlinear parameters of one shape."""
    begin = float(time[0])
    origin = _start_vector(start, shape, lines, law)
    scale = _scale(start, shape, origin.size)
    if law is not None:
        scale[-2:] = 0.02, 0.02 * start.decay / (2 * np.pi * start.frequency)

    def columns_at(moved: Array) -> Array:
        return columns_of(time, shape, origin + scale * moved, lines, begin=begin, bent=bent, law=law)

    latest: list[tuple[Array, Array, Array, Array]] = []  # slopes are asked where residuals were asked last

    def solved(moved: Array) -> tuple[Array, Array, Array]:
        """Columns, linear parameters and residuals."""
        if not latest or not np.array_equal(latest[0][0], moved):
            columns = columns_at(moved)
            latest[:] = [(moved.copy(), columns, *projected(columns, values))]
        return latest[0][1:]

    def residuals(moved: Array) -> Array:
        return solved(moved)[2]

    def slopes(moved: Array) -> Array:
        """Slopes of the residuals; the change of the projection itself is left out [Kaufman1975]_."""
        columns, sizes, _ = solved(moved)
        steps = SLOPE_STEP * np.eye(moved.size)
        changes = np.column_stack([(columns_at(moved + step) - columns) @ sizes for step in steps]) / SLOPE_STEP
        return -projected(columns, changes)[1]

    found = least_squares(residuals, np.zeros(origin.size), slopes, method="lm", xtol=1e-12, ftol=1e-12, max_nfev=150)
    vector = origin + scale * found.x
    _, sizes, left = solved(found.x)
    J = jacobian(time, shape, vector, lines, begin=begin, scale=scale, sizes=sizes, bent=bent, law=law)
    number = np.round((time - begin) * start.rate).astype(np.intp)
    covariance, colour = _covariance(
        J, left, number=number, turns=float(vector[1]) / (2 * np.pi * start.rate), sizes=sizes
    )
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
        law=law,
    )


def _covariance(J: Array, left: Array, *, number: NDArray[np.intp], turns: float, sizes: Array) -> tuple[Array, float]:
    """Covariance of the nonlinear and the linear parameters, and the colour of the residuals."""
    largest = np.max(np.abs(J), axis=0)  # of a law that does not fit its square may be beyond all numbers
    largest[largest == 0] = 1.0
    size = largest * np.sqrt(np.sum((J / largest) ** 2, axis=0))
    size[size == 0] = 1.0
    with np.errstate(over="ignore"):  # the variance of a number of which nothing is seen may be beyond all numbers too
        inverse = np.linalg.pinv((J / size).T @ (J / size), hermitian=True) / size / size[:, None]
    variance = float(left @ left) / max(left.size - J.shape[1], 1)
    rounding = variance < (1e-9 * float(np.abs(sizes[2:]).max())) ** 2
    colour = 1.0 if rounding else _colour(left, turns, number)
    return inverse * variance * colour, colour


def _colour(left: Array, turns: float, number: NDArray[np.intp]) -> float:
    """Residual spectrum around a frequency over that of white noise of the same variance, where significantly more.

    Missing readings count as zero: the power at a frequency is then that of what a wave read at the same instants
    takes up of the residuals, whatever is missing. The band holds enough ordinates for the chance excess to be small;
    a value within it counts as white.

    Parameters
    ----------
    left
        The residuals, shape (n,).
    turns
        The frequency over the sampling rate.
    number
        Which readings the residuals are of, from the first on, shape (n,).
    """
    every = np.zeros(int(number[-1]) + 1)
    every[number] = left - left.mean()
    power = np.abs(np.fft.rfft(every)) ** 2
    ordinates = power[1:-1] / max(float(power[1:-1].mean()), 1e-300)
    place = round(turns * float(number[-1]))
    reach = max(12, place // 8)
    band = ordinates[max(place - reach, 0) : place + reach + 1]
    if band.size < 12:
        return 1.0
    level = float(band.mean())
    # where readings are missing, ordinates depend on their neighbours
    independent = band.size * left.size / every.size
    return level if level > 1 + 4 / np.sqrt(independent) else 1.0
