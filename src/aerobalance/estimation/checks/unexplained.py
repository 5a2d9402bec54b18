"""Stretches of a record that the model of balance and load does not explain, and the force that it misses in them.

The smoother's answer to a reading is that of the whole record: of a load that changes, such as a chirp, a part of the
record has force at frequencies at which the prior has none. What the force lacks there is left in the residuals: with
H from the force in the reading to the force that is found, and G the balance, they are (1 - H) G F. So they are worked
back, (1 - H) F, where they stand out of the noise of their surroundings; noise that is stronger for a while does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from aerobalance.estimation.force_smoother import SmootherResult
from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.estimation.prior import resolved_bandwidth
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import argument
from aerobalance.recording.fourier import hann

BLOCK: Final = 256
"""Samples over which it is looked whether the readings are explained."""

CHANCE: Final = 8.0
"""Deviations of the mean square of the innovations that are never reached by chance."""

SUDDEN: Final = (4, 16, 64)
"""Samples over which it is looked as well whether something sudden happened that is no step that was found."""

BY_CHANCE: Final = 1e-9
"""Probability with which chance alone makes the mean square over so many samples as large as it must be for that."""

LONGEST_REACH: Final = 256
"""Samples beside something sudden, at most, in which the force goes wrong with it."""

STANDS_OUT: Final = 12.0
"""Power of a residual over that of the noise, of the block's own where that is stronger, that chance does not reach:
e^-12 for each of some hundred frequencies."""


def unexplained_stretches(
    fit: SmootherResult, white: Array, *, start: float, bends: Sequence[float]
) -> tuple[Array, list[Doubt], Array]:
    """Return variance of innovations over what is expected (n,) [1], what is told, and force that is missed (n,) [N].

    Parameters
    ----------
    fit
        The force, and the reading that it is of.
    white
        Innovations over their expected deviation, shape (n,).
    start
        Time of the first reading [s].
    bends
        Instants of sudden changes of slope, from the first reading [s]: there a stretch departs from any stationary
        force.
    """
    interval, name = fit.reading.interval, fit.reading.dynamics.component
    level, edges = excess_of(white)
    in_blocks = np.repeat(level, np.diff(edges))
    highest = resolved_bandwidth(fit.reading, fit.learned)
    reach = min(int(np.ceil(0.5 / max(highest * interval, 1e-3))), LONGEST_REACH)
    raised = np.maximum(in_blocks, sudden_excess(white, reach=reach))
    strange = np.flatnonzero(level > 1)
    if not strange.size:
        return raised, [], np.zeros(white.size)
    missed = missed_force(fit.reading, fit.learned, residuals=fit.residuals, strange=in_blocks > 1)
    bent = [int(np.searchsorted(edges, at / interval, side="right")) - 1 for at in bends]
    strange = np.setdiff1d(strange, [one + beside for one in bent for beside in (-1, 0, 1)])
    if not strange.size:
        return raised, [], missed
    worst = int(strange[np.argmax(level[strange])])
    first, last = (start + float(edge) * interval for edge in edges[worst : worst + 2])
    unit, there = si_unit(name), missed[in_blocks > 1]
    size = float(np.sqrt(np.mean(there**2)))
    shown = f"the force that the readings show beyond it, {size:.3g} {unit} rms, is" if size else "that of noise is"
    text = (
        f"in {strange.size} of {level.size} stretches the readings of {name} "
        f"depart from what the model of balance and load expects, most between {first:.4g} and {last:.4g} s "
        f"({np.sqrt(level[worst]):.2g} times the chance scatter); {shown} in the uncertainty there, but an error that "
        "the model makes everywhere is not"
    )
    advice = (
        "look at load and balance there: if it is an event shorter than the rest of the record lets expect, such as a "
        f"gust, compare with {argument('bandwidth', max(round(highest), 1))}, which smooths none"
    )
    return raised, [Doubt("unexplained", name, text, advice, unit=unit)], missed


def excess_of(white: Array) -> tuple[Array, NDArray[np.intp]]:
    """Variance of the innovations over what is expected, 1 where chance explains it, and the edges of the blocks.

    Parameters
    ----------
    white
        Innovations over their expected deviation, shape (n,).

    Returns
    -------
    level
        By block, shape (b,) [1].
    edges
        First sample of each block and the end of the last, shape (b + 1,).
    """
    count = max(white.size // BLOCK, 1)
    size, larger = divmod(white.size, count)
    edges = np.concatenate([[0], np.cumsum(np.where(np.arange(count) < larger, size + 1, size))])
    level = np.add.reduceat(white**2, edges[:-1]) / np.diff(edges)
    # the mean square over m samples scatters by sqrt(2 / m)
    return np.where(level > 1 + CHANCE * np.sqrt(2 * count / white.size), level, 1.0), edges


def sudden_excess(white: Array, *, reach: int) -> Array:
    """Variance of the innovations over what is expected where something sudden happened, else 1, shape (n,).

    The onset of a load, or a shock, is in few samples more than any prior of a stationary force allows. A block has it
    thinned out over all its samples, and none of it where a block ends beside it.

    Parameters
    ----------
    white
        Innovations over their expected deviation, shape (n,).
    reach
        Samples before and after, over which the force goes wrong with it.
    """
    level = np.ones(white.size)
    sums = np.concatenate([[0.0], np.cumsum(white**2)])
    for count in SUDDEN:
        if count > white.size:
            continue
        mean = (sums[count:] - sums[:-count]) / count
        least = float(chdtri(count, BY_CHANCE)) / count
        if not (mean > least).any():
            continue
        from scipy.ndimage import maximum_filter1d  # noqa: PLC0415 - takes 30 ms, and few records need it

        found = np.ones(white.size)
        found[: mean.size] = np.where(mean > least, mean, 1.0)
        # each window's mean square for all its samples, and for those that the force goes wrong in beside them
        width = count + 2 * reach
        shift = count - 1 + reach - width // 2
        level = np.maximum(level, maximum_filter1d(found, width, mode="constant", cval=1.0, origin=shift))
    return level


def missed_force(
    reading: Observation, learned: SpectralPrior, *, residuals: Array, strange: NDArray[np.bool_]
) -> Array:
    """Return what the residuals show of a force that the model misses, shape (n,) [N]; 0 where they show none.

    Parameters
    ----------
    reading, learned
        The record and its prior.
    residuals
        What the smoother leaves of the readings, shape (n,) [N].
    strange
        Samples that are not explained, shape (n,).
    """
    count, h = residuals.size, reading.interval
    length = 2 * BLOCK
    if count < length:
        return np.zeros(count)
    window = hann(length)
    frequency = np.asarray(np.fft.rfftfreq(length, h), dtype=np.float64)
    response = reading.dynamics.response(frequency)
    noise = learned.noise_density(frequency, interval=h) + np.abs(response) ** 2 * reading.input_density
    expected = noise / h * float(np.sum(window**2))
    padded = np.concatenate([np.zeros(BLOCK), residuals, np.zeros(length)])
    out = np.zeros(padded.size)
    for begin in range(0, count + BLOCK, BLOCK):  # half of each block overlaps the next: the windows add to one
        if not strange[max(begin - BLOCK, 0) : begin + BLOCK].any():
            continue
        spectrum = np.fft.rfft(window * padded[begin : begin + length])
        ratio = np.abs(spectrum) ** 2 / np.maximum(expected, 1e-300)
        own = max(1.0, float(np.median(ratio)) / np.log(2))
        shown = ratio > STANDS_OUT * own
        shown |= np.roll(shown, 1) | np.roll(shown, -1)  # the window gives a line to its neighbours
        out[begin : begin + length] += np.fft.irfft(np.where(shown, spectrum / response, 0.0), length)
    return out[BLOCK : BLOCK + count]
