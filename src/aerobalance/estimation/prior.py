"""What the record itself says of the force before it is known: its spectrum, and the noise of the reading."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from aerobalance.estimation.least_squares import generalised_least_squares, least_squares, log_likelihood
from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.estimation.spectra.periodogram import Periodogram, Spectrum
from aerobalance.estimation.spectra.whittle import fit_spectrum
from aerobalance.estimation.spectra.windows import density_of, share_of, share_seen
from aerobalance.estimation.statespace.kalman import FORCE, LOAD, KalmanFilter
from aerobalance.estimation.statespace.shaping_filter import EDGE, ShapingFilter
from aerobalance.recording.channel import Array
from aerobalance.recording.resampling import gaps_in, interpolate_gaps_linearly

BACKGROUND: Final = 1e-2
"""Variance of the force's background, over the variance of the estimate's error: nothing is taken as impossible."""

RESOLVED_AT: Final = 4097
"""Frequencies from zero to half the sampling rate at which it is looked whether force or noise is the stronger."""


TOLERANCE: Final = 100.0
"""Error of the shaping filter's density where it is largest, over the density of that background."""

EDGE_MOVES: Final = (0.5, 1.0, 2.0, 4.0)
"""Ordinates of the periodogram by which an edge of the spectrum is tried farther out, one after the other."""

EDGE_EVIDENCE: Final = 3.0
"""Gain in log-likelihood of the innovations for which an edge is moved by one of them."""

UNEVEN_FROM: Final = 256
"""Samples of a record below which its ends are not looked at."""

UNEVEN_BAND: Final = 32
"""Ordinates of a band at least in which power by an even window is compared with that by a Hann window: of noise they
differ by a fifth."""

UNEVEN: Final = 4.0
"""Ratio of the two from which on both are tried."""

UNEVEN_LEAK: Final = 0.03
"""Power in a band over that in the next one, up to which it may have leaked from there."""

UNEVEN_EVIDENCE: Final = 25.0
"""Gain in log-likelihood of the innovations for which the ends are weighed as the middle."""

BESIDE_A_GAP: Final = 64
"""Readings on either side of a gap at most from whose mean a line leads across it."""


HIDES: Final = 0.25
"""Periods of the balance from which on a gap is looked at for what it hides of the force's power: what is in shorter
ones is told by the readings beside them."""

MOST_HIDDEN: Final = 0.9
"""Share of the force's power that gaps may hide at most: of a record with less, its level is not made up for."""


def fit_prior(
    reading: Observation, *, columns: Array, before: SpectralPrior | None = None, smooth: bool = False
) -> SpectralPrior:
    """Find the spectrum of the force and the noise that make the readings most likely.

    Known shapes are taken out first by plain, then by generalised least squares; missing readings are bridged first by
    straight lines, then twice by what the smoother says they were.

    Parameters
    ----------
    reading
        The record.
    columns
        Known shapes whose sizes are free, shape (n, p): the constant, and the response to every step found so far.
    before
        What was learned before with nearly the same shapes: they are then taken out with it to begin with.
    smooth
        Whether the spectrum of the force rolls off smoothly, which says nothing of when a force may return.
    """
    present = reading.present
    if before is not None:
        return _learned_beside(reading, before, columns, smooth=smooth)
    shown = columns if present.all() else columns * present[:, None]
    sizes, *_ = least_squares(reading.filled, shown)
    left = np.where(present, reading.values - columns @ sizes, np.nan)
    left = interpolate_gaps_linearly(left, beside=BESIDE_A_GAP)
    learned = _learn(reading, left, smooth=smooth)
    if not present.all():
        # what a straight line leaves in a gap is noise to this first answer, and to the bridge that follows from it
        learned = _learned_beside(reading, learned, columns, smooth=smooth)
    elif columns.shape[1] == 1:
        return learned
    return _learned_beside(reading, learned, columns, smooth=smooth)


def _learned_beside(
    reading: Observation, learned: SpectralPrior, columns: Array, *, smooth: bool = False
) -> SpectralPrior:
    """What is learned when the known shapes are taken out under a prior, and gaps bridged by its smoother."""
    filled = bridged(reading, learned, columns=columns)
    return _learn(reading, filled, smooth=smooth, hidden=_hidden(reading, learned))


def _hidden(reading: Observation, learned: SpectralPrior) -> float:
    """Share of the force's power that gaps hide, though they are bridged, as a periodogram weights the record [1].

    In the middle of a long gap what bridges it is hardly more than its mean: the level of the force would be too low
    by that, and the uncertainty within the gap as well.
    """
    present = reading.present
    longest = max((last - first for first, last in gaps_in(~present)), default=0)
    if longest * reading.interval * reading.dynamics.natural_frequency < HIDES:
        return 0.0
    filter_ = _filter(reading, learned)
    whole = float(filter_.system.initial[FORCE, FORCE])
    if not whole > 0:
        return 0.0
    lost = np.where(present, 0.0, np.clip(filter_.smoothed_variance / whole, 0.0, 1.0))
    return min(1 - share_of(1 - lost), MOST_HIDDEN)


def bridged(reading: Observation, learned: SpectralPrior, *, columns: Array) -> Array:
    """Return the readings with known shapes taken out under a prior, and gaps bridged by its smoother, (n,) [N].

    Parameters
    ----------
    reading, learned
        The record, and the prior.
    columns
        Known shapes whose sizes are free, shape (n, p).
    """
    present = reading.present
    filter_ = KalmanFilter.of(reading.system(learned), present)
    sizes, *_ = generalised_least_squares(filter_, reading.filled, columns)
    left = np.where(present, reading.values - columns @ sizes, 0.0)
    return left if present.all() else np.where(present, left, filter_.smooth(left[:, None], [LOAD])[:, 0, 0])


def ends_differ(values: Array, interval: float) -> bool:
    """Whether readings without gaps, shape (n,) [N], have a band at their ends that a Hann window hides."""
    left = values - values.mean()
    by_hann, evenly = (density_of(left, interval, even=even) for even in (False, True))
    bands = [0]
    while (width := max(UNEVEN_BAND, bands[-1] // 10)) <= by_hann.size - bands[-1] - UNEVEN_BAND:
        bands.append(bands[-1] + width)
    hidden, shown = (np.add.reduceat(one, bands) for one in (by_hann, evenly))
    beside = np.maximum(np.append(shown[1:], 0.0), np.append(0.0, shown[:-1]))
    own = shown > UNEVEN_LEAK * beside  # beside a strong band the even window shows what leaks from it
    return bool(np.any(own & (shown >= UNEVEN * hidden) & (shown > 0)))


def evenly_weighted(reading: Observation, *, columns: Array) -> tuple[Observation, SpectralPrior | None]:
    """The reading, its ends weighed as its middle where that makes it much likelier, and its prior where it is known.

    The window of a periodogram hides the ends of a record. Where a load sweeps through frequencies, what was there at
    the ends is missing in the spectrum, and those readings are then taken for one shock after the other.

    Parameters
    ----------
    reading
        The record.
    columns
        Known shapes whose sizes are free, shape (n, p).
    """
    if not reading.present.all() or reading.values.size < UNEVEN_FROM:
        return reading, None
    if not ends_differ(reading.values, reading.interval):
        return reading, None
    both = (reading, replace(reading, even=True))
    priors = [refine_edges(one, fit_prior(one, columns=columns), columns=columns) for one in both]
    tapered, even = (evidence_of_prior(*one, columns=columns) for one in zip(both, priors, strict=True))
    chosen = int(even > tapered + UNEVEN_EVIDENCE)
    return both[chosen], priors[chosen]


def refine_edges(reading: Observation, learned: SpectralPrior, *, columns: Array) -> SpectralPrior:
    """The same with the edges of its spectrum where the innovations want them.

    Of a short record the periodogram shows an edge to a good ordinate only, but its readings tell much better: a load
    just beyond an edge that lies too far in is as strong as that within it, and is taken for a shock after the other.

    Parameters
    ----------
    reading
        The record.
    learned
        What was learned from its periodogram.
    columns
        Known shapes whose sizes are free, shape (n, p).
    """
    spectrum = learned.spectrum
    ordinate = 1 / (reading.values.size * reading.interval)
    # the shaping filter makes the edges of a longer record wider than that
    sharp = spectrum.edges[: -1 if spectrum.tail is None else -2]
    narrow = [place for place, edge in enumerate(sharp) if 2 * ordinate > EDGE * edge]
    if spectrum.roll_off or not narrow:
        return learned
    here = log_likelihood(reading, _filter(reading, learned), columns=columns)
    for place in narrow:
        for move in EDGE_MOVES:
            wider = _widened(reading, learned, place=place, width=move * ordinate)
            found = log_likelihood(reading, _filter(reading, wider), columns=columns)
            if found < here + EDGE_EVIDENCE:
                break
            learned, here = wider, found
    return learned


def _widened(reading: Observation, learned: SpectralPrior, *, place: int, width: float) -> SpectralPrior:
    """The same with one edge moved into the fainter of its two segments, or to the end of it."""
    edges, levels = learned.spectrum.edges.copy(), learned.spectrum.levels
    if levels[place] > levels[place + 1]:
        edges[place] = min(edges[place] + width, 0.5 * (edges[place] + edges[place + 1]))
    else:
        edges[place] = max(edges[place] - width, 0.5 * (edges[place] + (edges[place - 1] if place else 0.0)))
    spectrum = replace(learned.spectrum, edges=edges)
    return replace(learned, spectrum=spectrum, shaping=_shaped(reading, spectrum, learned.noise**2 * reading.interval))


def _learn(reading: Observation, values: Array, *, smooth: bool = False, hidden: float = 0.0) -> SpectralPrior:
    """The answer from readings without gaps and known shapes; what bridges a gap has no noise.

    Of the force's power they lack the share that is hidden.
    """
    interval, share = reading.interval, share_seen(reading.present)
    periodogram = periodogram_of(reading, values, share=share)
    fit = fit_spectrum(
        periodogram,
        noise_density=None if reading.noise is None else share * reading.noise**2 * interval,
        floor=reading.least_noise**2 * interval,
        smooth=smooth,
        rising=reading.rising,
    )
    density = fit.noise_density / share
    spectrum = replace(fit.spectrum, levels=fit.spectrum.levels / (1 - hidden)) if hidden else fit.spectrum
    shaping = _shaped(reading, spectrum, density)
    return SpectralPrior(
        spectrum, shaping, float(np.sqrt(density / interval)), reading.color, reading.rising, reading.even
    )


def periodogram_of(reading: Observation, values: Array, *, share: float) -> Periodogram:
    """Periodogram of readings without gaps and known shapes; what bridges a gap has no noise."""
    color = reading.color
    return Periodogram.of(
        values,
        reading.dynamics,
        interval=reading.interval,
        input_density=reading.input_density,
        color=None if color is None else lambda f, width: share * color.density(f, width=width),
        density=density_of(values, reading.interval, even=True) if reading.even else None,
        even=reading.even,
    )


def _shaped(reading: Observation, spectrum: Spectrum, noise_density: float) -> ShapingFilter:
    """The shaping filter of a spectrum, over a background so faint that the noise hides it."""
    highest = 0.5 / reading.interval
    frequency = np.linspace(0, highest, 8193)[1:]
    gain = np.abs(reading.dynamics.response(frequency)) ** 2
    density = spectrum.density(frequency)
    noise = noise_density + gain * reading.input_density
    if reading.color is not None:
        noise = noise + reading.color.density(frequency, width=float(frequency[0]))
    error = float(np.mean(density * noise / (gain * density + noise)))
    if not error > 0:
        return ShapingFilter.silent()
    ratio = gain * density / noise
    # a force below the noise at every frequency may still be shown by all of them: its edge is then where it is half
    # as strong as anywhere
    edge = float(frequency[ratio > (1.0 if ratio.max() > 1 else 0.5 * ratio.max())][-1])
    if spectrum.roll_off:
        edge = float(np.sqrt(edge * min(spectrum.roll_off[0], edge)))

    def whole(f: Array) -> Array:
        ratio = f / highest
        return np.asarray(spectrum.density(f) / (1 + (ratio / 32) ** 4) + BACKGROUND * error / (1 + ratio**4))

    return ShapingFilter.of_spectrum(whole, centre=edge, tolerance=float(np.sqrt(TOLERANCE * BACKGROUND * error)))


def _filter(reading: Observation, learned: SpectralPrior) -> KalmanFilter:
    return KalmanFilter.of(reading.system(learned), reading.present)


def evidence_of_prior(reading: Observation, learned: SpectralPrior, *, columns: Array) -> float:
    """Log-likelihood of a reading by what was learned, less Schwarz's price of the spectrum's parameters."""
    price = 0.5 * learned.spectrum.parameters * float(np.log(reading.values.size))
    return log_likelihood(reading, _filter(reading, learned), columns=columns) - price


def resolved_bandwidth(reading: Observation, learned: SpectralPrior) -> float:
    """Return the frequency up to which force is stronger in the reading than noise [Hz]; 0 if it is nowhere."""
    frequency = np.linspace(0, 0.5 / reading.interval, RESOLVED_AT)[1:]
    transfer = np.abs(reading.dynamics.response(frequency)) ** 2
    force = transfer * learned.spectrum.density(frequency)
    noise = transfer * reading.input_density + learned.noise_density(frequency, interval=reading.interval)
    above = np.flatnonzero(force > noise)
    return float(frequency[above[-1]]) if above.size else 0.0
