r"""The ringing of a balance on which a force acts all along, as wind does: maximum likelihood in a band around it.

What the force adds to the ringing is a stationary process with the balance's own resonance in it, so that it tells
natural frequency and damping as well, and blurs them: least squares take it for white noise, and it is none. At the
ordinates k of the discrete Fourier transform of the whole record the readings are

    Y_k = ringing of free size from the first reading on + noise of variance S_k |G_k|^2 + R,

where the swing that is there at both ends is a part of the ringing [Pintelon2012]_, so that nothing leaks.
Only the ordinates around the natural frequency count, over which the density S of the force is a power of e along the
band: what the force is elsewhere does not matter. All is searched by the method of scoring, and the information of the
likelihood is the uncertainty.

References
----------
.. [Pintelon2012] R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., Wiley 2012,
   section 6.3: the transient of a finite record is a term of the model, not an error.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.identification.free_decay.residual_lines import smooth_level
from aerobalance.identification.free_decay.waveform import DecayLine, DrivingForce, Ring, columns_of, jacobian
from aerobalance.recording.channel import Array
from aerobalance.recording.noise import white_noise

MEANS: Final = 24.0
"""Means in a period of the ringing over which the readings are taken together."""

BAND: Final = 0.06
"""Half of the band over the frequency of the ringing, at least."""

RATES: Final = 8.0
"""Half of the band over the decay rate [1 / 2 pi], at least."""

ORDINATES: Final = 12
"""Half of the band in ordinates, at least."""

WIDEST: Final = 0.5
"""Half of the band over the frequency of the ringing, at most."""

ASTRAY: Final = 1.5
"""By how much the first decay rate may be off before the band is taken anew."""

ITERATIONS: Final = 60
"""Steps of the search at most."""

SETTLED: Final = 1e-3
"""Gain of a step, in the logarithm of the likelihood, below which the search ends."""

HALVINGS: Final = 12
"""How often a step is shortened at most."""

PRIOR_WIDTH: Final = np.array([2.0, np.inf, 1.0])
"""How widely the parameters of the noise may depart from where they begin."""

RATIOS: Final = (0.002, 0.006, 0.02)
"""Damping ratios that are begun with: wind leads least squares astray."""

Complex = NDArray[np.complex128]


class RingBand:
    """The readings of a ring in a band around it."""

    def __init__(self, ring: Ring) -> None:
        self.ring = ring
        self.number = np.round((ring.time - ring.time[0]) * ring.rate).astype(np.intp)
        samples = int(self.number[-1] + 1)
        self.count = min(max(int(ring.rate / (MEANS * ring.frequency)), 1), samples)  # a ringing may be as short
        self.size = samples // self.count
        self.interval = self.count / ring.rate
        frequency = np.fft.rfftfreq(self.size, self.interval)
        spacing = 1 / (self.size * self.interval)
        if ring.force is None:
            half = max(BAND * ring.frequency, RATES * ring.decay / (2 * np.pi), ORDINATES * spacing)
            half = min(half, WIDEST * ring.frequency)
            self.ends = (ring.frequency - half, ring.frequency + half)
        else:
            self.ends = ring.force.band
        low, high = self.ends
        self.inside = np.flatnonzero((frequency >= low) & (frequency <= high))
        self.w = 2 * np.pi * frequency[self.inside]
        self.along = 2 * (frequency[self.inside] - low) / (high - low) - 1

    def __call__(self, values: Array) -> Complex:
        """Fourier transform of a residual or of columns, shape (n, ...), at the ordinates, times the interval."""
        filled = values
        if self.number.size != self.number[-1] + 1:
            every = np.arange(int(self.number[-1]) + 1)
            columns = [np.interp(every, self.number, column) for column in values.reshape(values.shape[0], -1).T]
            filled = np.array(columns).T.reshape(every.size, *values.shape[1:])
        whole = filled[: self.size * self.count]
        means = whole.reshape(self.size, self.count, *values.shape[1:]).mean(axis=1) if self.count > 1 else whole
        return np.asarray(np.fft.rfft(means, axis=0)[self.inside] * np.sqrt(self.interval / self.size))

    def minus_log_likelihood(self, left: Array) -> float:
        """Minus the logarithm of the likelihood of residuals that are white in the band, less what all have."""
        if not self.inside.size:
            return 0.0  # so short a ringing has no ordinate in its band, and that says nothing
        square = np.abs(self(left)) ** 2
        return float(square.size * (np.log(np.mean(square)) + 1))


def driven(ring: Ring, *, lines: tuple[DecayLine, ...] | None = None, bent: bool = False) -> Ring | None:
    """Return the ring with a force in it that acts all along; None where that leads nowhere.

    Parameters
    ----------
    ring
        An earlier fit over the same readings, free: with amplitude and phase of its own.
    lines
        Lines beside; those of the earlier fit where left out, or these and one more.
    bent
        Whether decay rate and frequency may change with the envelope.
    """
    lines = ring.lines if lines is None else lines
    search = _Search(ring, lines, bent)
    found = search.run()
    if found is None:
        return None
    decay = float(found[0][0])
    if ring.force is None and not ring.decay / ASTRAY < decay < ring.decay * ASTRAY:  # and so the band was another's
        search = _Search(replace(ring, decay=decay, vector=found[0][: ring.vector.size]), lines, bent)
        found = search.run()
    return None if found is None else search.ring(*found)


class _Search:
    """Parameters in one row: those of the waveform, sizes, and those of the noise."""

    def __init__(self, ring: Ring, lines: tuple[DecayLine, ...], bent: bool) -> None:
        self.begun, self.lines, self.bent, self.band = ring, lines, bent, RingBand(ring)
        self.begin, self.read = float(ring.time[0]), self.band(ring.values)
        known = [
            number
            for line in lines[len(ring.lines) :]
            for number in (2 * np.pi * line.frequency, *([line.decay] if line.decay else []))
        ]
        self.vector = np.concatenate([ring.vector, known])
        self.scale = np.full(self.vector.size, 1e-3 * abs(ring.decay) + 1e-7 * ring.frequency)
        self.noise = self._first_noise() if ring.force is None else ring.force.parameters
        self.centre = self.noise if ring.force is None else ring.force.centre

    def _first_noise(self) -> Array:
        ring = self.begun
        square = np.abs(self.band(ring.residuals)) ** 2
        white = white_noise(ring.residuals) ** 2 / ring.rate
        excess = max(float(np.mean(square)) - white, 0.1 * float(np.mean(square)))
        gain = float(np.mean(self._gain(max(ring.decay, 1e-6 * ring.frequency), float(ring.vector[1]))))
        return np.array([np.log(white), np.log(excess / gain), 0.0])

    def _gain(self, decay: float, w: float) -> Array:
        """Squared response at the ordinates, shape (k,)."""
        square = decay**2 + w**2
        return np.asarray(square**2 / ((square - self.band.w**2) ** 2 + (2 * decay * self.band.w) ** 2))

    def _spectrum(self, decay: float, w: float, noise: Array) -> Array:
        """Expected square of what is left, shape (k,)."""
        return np.asarray(np.exp(noise[0]) + np.exp(noise[1] + noise[2] * self.band.along) * self._gain(decay, w))

    def _split(self, parameters: Array) -> tuple[Array, Array, Array]:
        size, last = self.vector.size, parameters.size - 3
        return parameters[:size], parameters[size:last], parameters[last:]

    def _columns(self, vector: Array) -> Array:
        ring = self.begun
        return columns_of(ring.time, ring.shape, vector, self.lines, begin=self.begin, bent=self.bent)

    def _left(self, parameters: Array) -> Complex:
        vector, sizes, _ = self._split(parameters)
        return self.band(self.begun.values - self._columns(vector) @ sizes)

    def objective(self, parameters: Array) -> float:
        """Minus the logarithm of the likelihood and of the prior."""
        vector, noise = parameters[: self.vector.size], parameters[-3:]
        low, high = 0.3 * self.begun.frequency, 3 * self.begun.frequency
        sound = 0 < vector[0] < vector[1] and low < vector[1] / (2 * np.pi) < high
        if not sound or np.abs(noise - self.centre).max() > 30:
            return np.inf
        square, expected = np.abs(self._left(parameters)) ** 2, self._spectrum(vector[0], vector[1], noise)
        found = float(np.sum(np.log(expected) + square / expected)) + self._prior(noise)
        return found if np.isfinite(found) else np.inf

    def _prior(self, noise: Array) -> float:
        return 0.5 * float(np.sum(((noise - self.centre) / PRIOR_WIDTH) ** 2))

    def score(self, parameters: Array) -> tuple[Array, Array]:
        """Gradient of the objective, shape (p,), and the information, shape (p, p)."""
        vector, sizes, noise = self._split(parameters)
        ring, (decay, w) = self.begun, vector[:2]
        J = jacobian(
            ring.time,
            ring.shape,
            vector,
            self.lines,
            begin=self.begin,
            scale=self.scale,
            sizes=sizes,
            bent=self.bent,
        )
        slopes = np.zeros((self.band.w.size, parameters.size), dtype=np.complex128)
        slopes[:, : J.shape[1]] = self.band(J)
        slopes[:, self.vector.size] = 0.0  # a constant is not in the band
        left = self.band(ring.values - J[:, vector.size :] @ sizes)
        expected = self._spectrum(decay, w, noise)
        growth = np.zeros((self.band.w.size, parameters.size))
        for place, step in enumerate(self.scale[:2]):
            moved = [(decay + sign * (place == 0) * step, w + sign * (place == 1) * step) for sign in (1, -1)]
            late, early = (np.log(self._spectrum(*at, noise)) for at in moved)
            growth[:, place] = (late - early) / (2 * step)
        forced = 1 - np.exp(noise[0]) / expected
        growth[:, -3:] = np.column_stack([1 - forced, forced, forced * self.band.along])
        square = np.abs(left) ** 2 / expected
        gradient = growth.T @ (1 - square) - 2 * np.real(slopes.conj().T @ (left / expected))
        information = growth.T @ growth + 2 * np.real((slopes / expected[:, None]).conj().T @ slopes)
        gradient[-3:] += (noise - self.centre) / PRIOR_WIDTH**2
        information[-3:, -3:] += np.diag(1 / PRIOR_WIDTH**2)
        return gradient, information

    def run(self) -> tuple[Array, float, Array] | None:
        """Parameters, objective and information at the largest likelihood; None where the search fails."""
        if self.band.w.size < 2 * (self.vector.size + 7):
            return None
        found = [self._climbed(at) for at in self._first()]
        found = [one for one in found if np.isfinite(one[1])]
        if not found:
            return None
        at, here = min(found, key=lambda one: one[1])
        return at, here, self.score(at)[1]

    def _climbed(self, at: Array) -> tuple[Array, float]:
        """Parameters at the largest likelihood that a search comes to, and the objective there."""
        here, damping = self.objective(at), 0.0
        if not np.isfinite(here):
            return at, here
        for _ in range(ITERATIONS):
            gradient, information = self.score(at)
            size = _sizes(information)
            unit = information / np.outer(size, size) + 1e-12 * np.eye(size.size)
            for _ in range(HALVINGS):
                step = -np.linalg.solve(unit + damping * np.eye(size.size), gradient / size)
                there = self.objective(at + step / size)
                if there <= here:
                    break
                damping = max(4 * damping, 1e-3)
            else:
                break
            gain, at, here = here - there, at + step / size, there
            damping = damping / 8 if damping > 1e-6 else 0.0
            if gain < SETTLED:
                break
        return at, here

    def _first(self) -> list[Array]:
        """Parameters to begin with: some damping ratios, each at the better of two frequencies."""
        if self.begun.force is not None:
            return [self._with_sizes(self.vector)]
        strongest = float(self.band.w[np.argmax(np.abs(self.read))])
        found = []
        for ratio in RATIOS:
            trials = [
                self._with_sizes(np.concatenate([[ratio * w, w], self.vector[2:]]))
                for w in (float(self.vector[1]), strongest)
            ]
            found.append(min(trials, key=self.objective))
        return found

    def _with_sizes(self, vector: Array) -> Array:
        """All parameters, with the sizes that least squares gives to some of the waveform."""
        decay, w = max(float(vector[0]), 1e-6 * self.begun.frequency), float(vector[1])
        vector = np.concatenate([[decay], vector[1:]])
        every = np.column_stack([self.band(self._columns(vector)), self.read])
        every[:, 0] = 0.0  # a constant is not in the band
        weighed = every / np.sqrt(self._spectrum(decay, w, self.noise))[:, None]
        both = np.concatenate([weighed.real, weighed.imag])
        sizes = np.linalg.lstsq(both[:, :-1], both[:, -1], rcond=1e-12)[0]
        return np.concatenate([vector, sizes, self.noise])

    def ring(self, at: Array, objective: float, information: Array) -> Ring:
        """The parameters as a ring, its residuals over what their spectrum shows beyond the noise."""
        ring = self.begun
        vector, sizes, noise = self._split(at)
        size = _sizes(information)
        inverse = np.linalg.pinv(information / np.outer(size, size), hermitian=True) / np.outer(size, size)
        last = vector.size + sizes.size
        covariance = inverse[:last, :last]
        sizes = sizes.copy()
        sizes[0] = 0.0
        left = ring.values - self._columns(vector) @ sizes
        sizes[0] = float(left.mean())
        gain = (vector[0] ** 2 + vector[1] ** 2) / (4 * vector[0] ** 2)  # at the undamped frequency
        place, fitted = 2, []
        for line in self.lines:
            decay = abs(float(vector[place + 1])) if line.decay else 0.0
            fitted.append(DecayLine(float(vector[place]) / (2 * np.pi), decay))
            place += 1 + (line.decay > 0)
        return replace(
            ring,
            frequency=float(vector[1]) / (2 * np.pi),
            decay=float(vector[0]),
            start=self.begin,
            lines=tuple(fitted),
            bent=self.bent,
            vector=vector,
            sizes=sizes,
            covariance=(covariance + covariance.T) / 2,
            colour=1.0,
            residuals=self._whitened(left - sizes[0], vector[0], vector[1], noise),
            force=DrivingForce(
                density=float(np.exp(noise[1])),
                band=self.band.ends,
                objective=objective,
                over_noise=float(np.exp(noise[1] - noise[0]) * gain),
                parameters=noise,
                centre=self.centre,
            ),
        )

    def _whitened(self, left: Array, decay: float, w: float, noise: Array) -> Array:
        """Residuals with the same level at all frequencies, that of their noise, shape (n,).

        What rings is first taken out from reading to reading, so that nothing of it reaches beyond where it is.
        """
        number, rate = self.band.number, self.begun.rate
        filled = np.interp(np.arange(int(number[-1]) + 1), number, left)
        turn = np.exp(complex(-decay, w) / rate)
        taps = np.array([1.0, -2 * turn.real, abs(turn) ** 2])
        pushed = np.zeros(filled.size)
        pushed[2:] = np.convolve(filled, taps, mode="valid")
        spectrum = np.fft.rfft(pushed)
        line = 2 * np.pi * np.fft.rfftfreq(filled.size, 1 / rate)
        square = decay**2 + w**2
        gain = square**2 / ((square - line**2) ** 2 + (2 * decay * line) ** 2)
        undone = np.abs(np.exp(-1j * np.outer(line / rate, np.arange(3))) @ taps) ** 2
        level = (np.exp(noise[0]) + np.exp(noise[1]) * gain) * undone
        # outside the band the force is another: what stands beside this level is smooth
        level *= smooth_level(np.abs(spectrum) ** 2 / level)
        spectrum[0] = 0.0
        white = np.fft.irfft(spectrum / np.sqrt(level), filled.size)[number]
        return np.asarray(white * white_noise(left) * np.sqrt(filled.size))


def _sizes(information: Array) -> Array:
    """Roots of the diagonal, 1 where it is nothing, shape (p,)."""
    diagonal = np.diag(information)
    return np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
