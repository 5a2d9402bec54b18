"""How likely forces are that rows of polynomials make of the readings of coupled components.

The forces' spectra are taken for constant over bands much wider than a resonance, and independent of each other. Lines
of forces have the covariance diag(S_F) + W R W^H: the rows W make noise of one channel, of density R, noise of several
forces. The likelihood counts all of it, and what the balance makes of a force as well, |det W|, so other frequencies,
signs and orders may be compared with each other. Where there is little but noise, the covariance is W R W^H and its
determinant |det W|^2 det R: nothing is told there, whatever the rows are. Taken for a noise of its own in every force,
the same noise speaks for the rows that make it so.

Where a change within one run's uncertainty is looked for, one more thing counts that no doubt depends on
(`RingingSpectra.joint_evidence`): beyond the end of a load there is only what the window leaks there from other
frequencies, which other rows have at those frequencies.

References
----------
.. [Dempster1977] A. P. Dempster, N. M. Laird, D. B. Rubin, "Maximum likelihood from incomplete data via the EM
   algorithm", J. R. Stat. Soc. B 39 (1977) 1.
.. [Schwarz1978] G. Schwarz, "Estimating the dimension of a model", Ann. Stat. 6 (1978) 461.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.decoupling import DecoupledChannel
from aerobalance.estimation.checks._covariance_kernels import likeliest_covariances
from aerobalance.estimation.checks._level_kernels import ForceLines, likeliest_levels, likeliest_levels_and_noise
from aerobalance.estimation.checks.channel_rows import Rows, mean_determinant, powers_of, product_of_modes
from aerobalance.estimation.checks.coherence import WORTH_A_LOOK, excess_of_coherence
from aerobalance.estimation.checks.split_loads import SplitLoads
from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.estimation.result import ComponentForce
from aerobalance.estimation.spectra._kernels import Search
from aerobalance.estimation.spectra.periodogram import Periodogram
from aerobalance.estimation.spectra.windows import HANN_BANDWIDTH, leaked_from
from aerobalance.recording.channel import Array
from aerobalance.recording.fourier import hann
from aerobalance.recording.side_by_side import side_by_side


@dataclass(frozen=True, slots=True)
class RingingSettings:
    """What of a record is compared.

    Attributes
    ----------
    samples
        Samples that are looked at at most.
    highest
        Frequency up to which forces are compared, over the highest natural frequency.
    width, fewest
        Width of a band over its frequency, and ordinates in it at least.
    iterations, enough
        Iterations at most by which the levels of a band are found, and gain in log-likelihood from which on no more
        are made: some ten bands that differ by less do not add up to one.
    fine
        Points of an ordinate in which the determinant is averaged.
    stands_out
        Power of the channels over that of their noise and the ground's, their mean in a band, from which the band is
        compared.
    leaked, leaked_one
        Share of the power about an ordinate that the window may leak there from others: the geometric mean of all
        forces, whose chance averages out, and the most of one. A Hann window leaks 0.002 of a flat spectrum beyond its
        main lobe; a hundredth moves the slope of the likelihood by a hundredth of what chance does at one ordinate,
        and by a tenth of it over a hundred of them.
    own
        Share of the ordinates of a band that are clear, from which it tells whether forces go together.
    rounds
        Rounds by which the covariance of forces that go together is found: with ten the likelihoods of two balances
        differ by what they do after 300, to one in a hundred.
    noisy
        Share of a line's density that is noise, from which its correlation with others counts: below it the square of
        their coherence is less than that, and so is what an ordinate tells by it.
    """

    samples: int = 1 << 15
    highest: float = 1.5
    width: float = 0.12
    fewest: int = 8
    iterations: int = 8
    enough: float = 0.02
    fine: int = 2
    stands_out: float = 10.0
    in_common: float = 10.0
    leaked: float = 0.01
    leaked_one: float = 0.1
    own: float = 0.9
    rounds: int = 10
    noisy: float = 1e-3


SETTINGS: Final = RingingSettings()
"""Settings that are used."""

COLORED: Final = Search(np.empty(0), np.empty(0), steps=60, enough=0.02, longest=3.0, damping=0.01)
"""How levels of forces and of noise are looked for."""

AKAIKE: Final = 1.0
"""Price in log-likelihood of a number that is fitted (H. Akaike, IEEE Trans. Autom. Control 19 (1974) 716)."""

ROUNDING: Final = 1e-12
"""Power of a force of the ground's motion over the largest, each over its channel's noise, that is rounding."""

SMOOTHED: Final = 3
"""Ordinates over which the power about one is averaged: a main lobe."""


def most_samples(record: CoupledRecord) -> int:
    """Return how many samples of a record are looked at at most: as long a time on any clock."""
    return SETTINGS.samples // record.recording.decimated


@dataclass(frozen=True, eq=False)  # without slots: what is worked out once is kept
class RingingSpectra:
    """Spectra of all that rows of polynomials can make of a record.

    Attributes
    ----------
    frequency
        Frequencies of the ordinates [Hz], shape (m,).
    lines
        Spectral lines of every channel's powers of s over the modes of every decoupled component, times the product
        of these modes at the ordinate, shape (n, p, n, m). What the ground's motion has put on the loads is in them.
    gain
        Square of the response of the decoupled components as the window sees it, times that of the product, (n, m).
    noise
        Densities of the channels' noise, shape (n,).
    bands
        First ordinate of every band.
    shown
        True where the channels are clearly above their noise: elsewhere they say nothing of the modes, shape (m,).
    clear
        True where forces are above their noise, and no force or channel has much of what the window leaks there from
        other frequencies, shape (m,).
    own
        The rows that the record was read with.
    of_ground
        Spectral lines of the forces that the ground's motion puts on the moving mass, as those of `readings`, (n, m):
        they are known whatever the rows are, by its mass. None where the ground is at rest.
    """

    frequency: Array
    lines: NDArray[np.complex128]
    gain: Array
    noise: Array
    bands: NDArray[np.intp]
    shown: NDArray[np.bool_]
    clear: NDArray[np.bool_]
    own: Rows
    of_ground: NDArray[np.complex128] | None = None

    @classmethod
    def of(
        cls, record: CoupledRecord, given: SplitLoads, parts: Mapping[str, ComponentForce]
    ) -> RingingSpectra | None:
        """Take the spectra of loads; None where a record is too short.

        Parameters
        ----------
        record
            The record that they are from.
        given
            The loads.
        parts
            The forces that were worked out.
        """
        most = most_samples(record)
        loads, felt = (one[:most] - one[:most].mean(axis=0) for one in given)
        whole, shaken = loads + felt, bool(felt.any())
        count, interval = loads.shape[0], record.interval
        step = 1 / (count * interval)
        top = SETTINGS.highest * max(mode.natural_frequency for mode in record.dynamics.modes)
        last = int(min(top / step, count // 2 - 2))
        if last - 2 < SETTINGS.fewest:
            return None
        bands = _bands(last - 2)
        window = _window(count, interval)
        inside, channels = slice(2, last), loads.shape[1]
        lines = np.empty((channels, record.decoupled[0].row.shape[1], channels, last - 2), dtype=np.complex128)
        of_ground = np.empty((channels, last - 2), dtype=np.complex128) if shaken else None

        def seen_of(one: DecoupledChannel) -> tuple[Array, Array, Array]:
            """Power of a component's force, that of the product of its modes, and its gain; its lines are kept."""
            powers = powers_of(one, whole, interval=interval)
            seen = Periodogram.of(loads[:, one.place], one.dynamics, interval=interval)
            product = product_of_modes(one, seen.ordinates[0, : last - 2])
            driven = np.fft.rfft(powers * window)
            force = np.einsum("pjm,jp->m", driven, one.row, optimize=True)
            if of_ground is not None:
                motion = np.einsum("pjn,jp->n", powers_of(one, felt, interval=interval), one.row, optimize=True)
                known = np.fft.rfft(motion * window)
                force = force - known
                of_ground[one.place] = known[inside] * product
            np.multiply(driven[..., inside], product, out=lines[one.place])
            over = np.abs(product) ** 2
            return np.abs(force) ** 2, over, seen.ordinates[2, : last - 2] * over

        forces, over, gains = zip(*side_by_side(seen_of, record.decoupled), strict=True)
        frequency = np.arange(2, last) * step
        noise = np.array([parts[name].noise for name in record.dynamics.components]) ** 2 * interval
        read = np.abs(np.fft.rfft(loads * window[:, None], axis=0).T) ** 2
        raw = read[:, inside]
        widths = np.diff(np.append(bands, frequency.size))
        # noise of the ground's sensors is a force that all components have in common, and rings as one
        response = record.dynamics.response(frequency)
        shaken = np.einsum("mij,jk,mik->im", response, record.motion_covariance, response.conj(), optimize=True)
        shaking = SETTINGS.in_common * interval * np.real(shaken)
        level = _sums(raw / (noise[:, None] + shaking), bands).mean(axis=0) / widths
        shown = np.repeat(level > SETTINGS.stands_out, widths)
        rows = Rows(np.stack([one.row for one in record.decoupled]))
        quiet = np.einsum("mij,j->im", np.abs(rows.at(frequency)) ** 2, noise) / np.stack(over)
        powers_of_forces = np.stack(forces)
        above = (_smoothed(powers_of_forces)[:, inside] / quiet).mean(axis=0)
        clear = (above > SETTINGS.stands_out) & (_own(powers_of_forces) & _own(read))[inside]
        return cls(
            frequency,
            lines,
            np.stack(gains),
            noise,
            bands,
            shown,
            clear,
            rows,
            of_ground,
        )

    def about(self, frequencies: Sequence[float]) -> NDArray[np.bool_]:
        """Ordinates of the bands that some frequencies [Hz] are in, shape (m,)."""
        widths = np.diff(np.append(self.bands, self.frequency.size))
        inside = np.searchsorted(self.frequency[self.bands], np.array(frequencies), side="right") - 1
        return np.repeat(np.isin(np.arange(self.bands.size), inside), widths)

    def near(self, frequency: float, *, within: float) -> RingingSpectra | None:
        """The same in the bands that begin near a frequency [Hz]; None where there are none.

        `within` is the largest logarithm of a band's first frequency over it.
        """
        away = np.abs(np.log(self.frequency[self.bands] / frequency))
        inside = np.flatnonzero(away < within)
        if not inside.size:
            return None
        first = int(self.bands[inside[0]])
        ends = np.append(self.bands[1:], self.frequency.size)
        part = slice(first, int(ends[inside[-1]]))
        return replace(
            self,
            frequency=self.frequency[part],
            lines=np.ascontiguousarray(self.lines[..., part]),
            of_ground=None if self.of_ground is None else np.ascontiguousarray(self.of_ground[:, part]),
            gain=np.ascontiguousarray(self.gain[:, part]),
            bands=self.bands[inside] - first,
            shown=self.shown[part],
            clear=self.clear[part],
        )

    def readings(self, rows: Rows) -> NDArray[np.complex128]:
        """Spectral lines of the decoupled components' readings by other rows, less the ground's motion, (n, m)."""
        # the rows are real: products of real numbers, both parts of a line in their turn
        count, powers, channels, size = self.lines.shape
        parts = self.lines.view(np.float64).reshape(count, powers * channels, 2 * size)
        found = np.matmul(rows.forces.transpose(0, 2, 1).reshape(count, 1, -1), parts)
        lines = np.asarray(found.reshape(count, 2 * size).view(np.complex128))
        return lines if self.of_ground is None else lines - rows.order @ self.of_ground

    def with_motion(self, change: NDArray[np.complex128]) -> RingingSpectra:
        """The same where the ground's motion puts further forces on the moving mass, their lines of shape (n, m)."""
        return replace(self, of_ground=change if self.of_ground is None else self.of_ground + change)

    def lines_of(self, forces: Array, *, interval: float) -> NDArray[np.complex128]:
        """Lines of forces on the moving mass, shape (samples, n), as those of `of_ground`, shape (n, m)."""
        count = round(1 / (interval * (self.frequency[1] - self.frequency[0])))
        some = forces[:count] - forces[:count].mean(axis=0)
        lines = np.fft.rfft(some * _window(count, interval)[:, None], axis=0).T
        first = round(float(self.frequency[0]) * count * interval)
        return np.asarray(lines[:, first : first + self.frequency.size])

    def shows_motion(self, rows: Rows) -> bool:
        """Whether forces by these rows go with that of the ground's motion, more than by chance."""
        if self.of_ground is None or not self.shown.any():
            return False
        widths = np.diff(np.append(self.bands, self.frequency.size))
        told = self.shown[self.bands]
        here, counts = np.repeat(told, widths), widths[told] / HANN_BANDWIDTH
        firsts = np.cumsum(widths[told]) - widths[told]
        power = np.sum(np.abs(self.of_ground) ** 2 / self.gain, axis=1)
        moved = power > ROUNDING * np.max(power / self.noise) * self.noise  # others have what is left of rounding
        found = excess_of_coherence(
            self.readings(rows)[moved][:, here], self.of_ground[moved][:, here], firsts, counts
        )
        return found > WORTH_A_LOOK

    def evidence_apart(
        self, rows: Rows, *, determinant: Array | None = None, told: NDArray[np.bool_] | None = None
    ) -> Array:
        """Logarithm of the likelihood in every band of forces that have nothing to do with each other, shape (bands,).

        Their levels there are at their best.

        Parameters
        ----------
        rows
            The rows.
        determinant
            What `determinant` gives of them, where it is known.
        told
            Ordinates that count, shape (m,): those that are shown where none are given.
        """
        told = self.shown if told is None else told
        found = np.empty(self.bands.size)
        likeliest_levels(self._forces(rows, told), self.bands, SETTINGS.iterations, SETTINGS.enough, found)
        return self._less_volume(found, rows, told, determinant)

    def evidence_with_color(self, rows: Rows, *, determinant: Array | None = None) -> Array:
        """Logarithm of the likelihood in every band where the channels' noise may have any level there, (bands,).

        It is that with white noise where more brings less than Akaike's price of its numbers: a channel's level in a
        band is one. What has a color and is taken for white noise is in several forces, as the rows make it, and
        speaks for rows that make it least so.

        Parameters
        ----------
        rows
            The rows.
        determinant
            What `determinant` gives of them, where it is known.
        """
        volume = self.determinant(rows) if determinant is None else determinant
        forces, found = self._forces(rows, self.shown), np.empty(self.bands.size)
        channels = np.linalg.solve(forces.rows, forces.lines.T[..., None])[..., 0].T
        powers = np.ascontiguousarray(np.abs(channels) ** 2)  # as memory has them beforehand, and so compiled
        likeliest_levels_and_noise(forces, powers, self.bands, COLORED, found)
        colored = self._less_volume(found, rows, self.shown, volume) - AKAIKE * self.noise.size
        return np.maximum(self.evidence_apart(rows, determinant=volume), colored)

    def evidence_together(self, rows: Rows, *, determinant: Array | None = None) -> Array:
        """Logarithm of the likelihood in every band where one load may act in several forces, shape (bands,).

        A gust or a release does: the covariance of the forces is any that is constant in a band, found by expectation
        and maximisation [Dempster1977]_.

        Parameters
        ----------
        rows
            The rows.
        determinant
            What `determinant` gives of them, where it is known.
        """
        found, told = np.zeros(self.bands.size), self.shown[self.bands]  # a band is shown, or nothing of it
        if told.any():
            found[told] = self._together_where_shown(rows, told)
        return self._less_volume(found, rows, self.shown, determinant)

    def _together_where_shown(self, rows: Rows, told: NDArray[np.bool_]) -> Array:
        """Log-likelihood of lines of the forces in the bands that are told, one load in several of them, (told,)."""
        widths = np.diff(np.append(self.bands, self.frequency.size))
        here, widths = np.repeat(told, widths), widths[told]
        bands = np.cumsum(widths) - widths
        gain, frequency = self.gain[:, here].T, self.frequency[here]
        whole, root = rows.at(frequency), np.sqrt(gain)
        lines = self.readings(rows).T[here] / root
        noise = np.einsum("mij,j,mkj->mik", whole, self.noise, whole.conj(), optimize=True)
        noise /= root[:, :, None] * root[:, None, :]
        number = widths[:, None, None]
        products = np.add.reduceat(lines[:, :, None] * lines[:, None, :].conj(), bands)
        covariance = np.asarray(products / number, dtype=np.complex128)
        # forces and moments in units that are alike
        size = np.sqrt(np.einsum("bii->i", covariance).real + 1e-300)
        lines, noise = lines / size, noise / np.outer(size, size)
        covariance /= np.outer(size, size)
        found = np.empty(bands.size)
        lines, noise = np.ascontiguousarray(lines), np.ascontiguousarray(noise)
        likeliest_covariances(lines, noise, bands, SETTINGS.rounds, covariance, found)
        return found - 2 * widths * float(np.sum(np.log(size))) - np.add.reduceat(np.log(gain).sum(axis=1), bands)

    def evidence(self, rows: Rows, *, determinant: Array | None = None) -> Array:
        """Logarithm of the likelihood in every band of loads of any kind, shape (bands,).

        It is that of forces that have nothing to do with each other, or where one load acts in several, that of their
        covariance where more brings less than the price of its numbers.

        Parameters
        ----------
        rows
            The rows.
        determinant
            What `determinant` gives of them, where it is known.
        """
        volume = self.determinant(rows) if determinant is None else determinant
        found = self.evidence_apart(rows, determinant=volume)
        if not self.together:
            return found
        return np.maximum(found, self.evidence_together(rows, determinant=volume) - self._price_of_covariance)

    @property
    def _price_of_covariance(self) -> Array:
        """Price in log-likelihood of what a covariance has over levels, in every band [Schwarz1978]_, (bands,)."""
        count, size = np.add.reduceat(self.shown, self.bands, dtype=int), len(self.noise)
        return np.asarray(0.5 * size * (size - 1) * np.log(np.maximum(2 * count, 1)))

    @cached_property
    def together(self) -> bool:
        """Whether one load acts in several forces: a covariance is likelier than levels of each, its price paid.

        Beyond the end of a load all forces have in common what the window leaks there: such bands are left out.
        """
        widths = np.diff(np.append(self.bands, self.frequency.size))
        count, size = np.add.reduceat(self.shown, self.bands, dtype=int), len(self.noise)
        own = np.add.reduceat(self.clear, self.bands, dtype=int) >= SETTINGS.own * widths
        # what the forces have in common first, noise among it: that is nearly nothing to work out
        lines = (self.readings(self.own) / np.sqrt(self.gain)).T * self.shown[:, None]
        power = np.repeat(np.add.reduceat(np.abs(lines) ** 2, self.bands), widths, axis=0)
        lines = lines / np.sqrt(np.maximum(power, 1e-300))
        alike = np.add.reduceat(lines[:, :, None] * lines[:, None, :].conj(), self.bands)
        enough = own & (count > size)
        gain = -np.linalg.slogdet(alike[enough])[1] @ count[enough] / HANN_BANDWIDTH
        price = float(np.sum(self._price_of_covariance[own]))
        if gain < price:
            return False
        return float(np.sum((self.evidence_together(self.own) - self.evidence_apart(self.own))[own])) > price

    def _forces(self, rows: Rows, told: NDArray[np.bool_]) -> ForceLines:
        """What rows make of the record, of one order in memory also of a stretch: the loops are compiled for each."""
        lines, whole = np.ascontiguousarray(self.readings(rows)), np.ascontiguousarray(rows.at(self.frequency))
        gain, told = np.ascontiguousarray(self.gain), np.ascontiguousarray(told)
        return ForceLines(lines, whole, self.noise, gain, told, SETTINGS.noisy)

    def _less_volume(self, found: Array, rows: Rows, told: NDArray[np.bool_], determinant: Array | None) -> Array:
        """Log-likelihoods of independent ordinates of the channels, by those of all of the forces, shape (bands,)."""
        volume = self.determinant(rows) if determinant is None else determinant
        return np.asarray(found + np.add.reduceat(volume * told, self.bands)) / HANN_BANDWIDTH

    def joint_evidence(self, rows: Rows) -> float:
        """Logarithm of the likelihood in all bands, of ordinates that a force reaches itself.

        Beyond the end of a load there is what the window leaks: it has gone through the rows at the frequencies that
        it comes from, and is left out.

        Parameters
        ----------
        rows
            The rows.
        """
        return float(np.sum(self.evidence_apart(rows, told=self.shown & self.clear)))

    def determinant(self, rows: Rows) -> Array:
        """Mean about every ordinate of the logarithm of the squared determinant of the rows, shape (m,)."""
        step = float(self.frequency[1] - self.frequency[0])
        first = round(float(self.frequency[0]) / step)
        return mean_determinant(rows, step, first, first + self.frequency.size, fine=SETTINGS.fine)


def _window(count: int, interval: float) -> Array:
    """Hann window by which squares of lines are densities, shape (count,) [s^0.5]."""
    window = hann(count)
    return np.asarray(window * np.sqrt(interval / float(np.sum(window**2))))


def _own(power: Array) -> NDArray[np.bool_]:
    """Whether the power of several series about each ordinate, (n, m), is its own and not leaked from others, (m,)."""
    leaked = np.stack([leaked_from(one) for one in power])
    share = leaked / np.maximum(_smoothed(power), 1e-300)
    together = np.exp(np.mean(np.log(np.maximum(share, 1e-300)), axis=0))
    return np.asarray((together < SETTINGS.leaked) & (share.max(axis=0) < SETTINGS.leaked_one))


def _smoothed(power: Array) -> Array:
    """Mean of series about each ordinate, over a main lobe, shape (n, m)."""
    return np.stack([np.convolve(one, np.ones(SMOOTHED) / SMOOTHED)[SMOOTHED // 2 :][: one.size] for one in power])


def _sums(values: Array, first: NDArray[np.intp]) -> Array:
    return np.asarray(np.add.reduceat(values, first, axis=1))


def _bands(count: int) -> NDArray[np.intp]:
    """First ordinates of bands, each a part of its frequency wide."""
    first, place = [], 0
    while place < count:
        first.append(place)
        place += max(SETTINGS.fewest, round(SETTINGS.width * place))
    return np.array(first[:-1] if len(first) > 1 and count - first[-1] < SETTINGS.fewest else first, dtype=np.intp)
