"""What a record of a ringing is made of: lines beside the ringing, a law or a second mode, and the part to be used."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from aerobalance.identification.free_decay.amplitude_dependence import (
    PLAIN,
    AmplitudeDependence,
    amplitude_dependence,
    bent_fit,
)
from aerobalance.identification.free_decay.driven import RingBand, driven
from aerobalance.identification.free_decay.law import (
    AmplitudeLaw,
    by_law,
    close_lines,
    decays_by,
    levelled,
    likeliest_law,
    of_two_modes,
)
from aerobalance.identification.free_decay.residual_lines import residual_line
from aerobalance.identification.free_decay.ring_fit import EVIDENCE, fit_ring, freed
from aerobalance.identification.free_decay.waveform import HEAVIEST, Ring, columns_of, projected
from aerobalance.recording.channel import Array

MOST_LINES: Final = 6
"""Lines of hum and further modes that are taken up at most."""

BLOCK_PROBABILITY: Final = 1e-6
"""Probability under the noise below which a block of residuals shows that something else happened."""

COLOURED: Final = 2.0
"""Level of the residuals near the ringing over that of white noise from which they are no noise."""

FAR: Final = 20.0
"""Periods between the release fitted and the first look at it from which the fit is led astray."""

LEVEL_CHANGE: Final = 4.0
"""Change of level over the scatter of means from which it is that of a release."""

CLEAR_OF: Final = 3.0
"""Periods after the release from which on the ringing is free."""

BROKEN: Final = 0.25
"""Gap in the readings, in periods, over which a force that acts all along is not followed."""

MISSING: Final = 0.1
"""Share of a record in such gaps up to which they are bridged all the same, as they hardly matter."""

FORCE_EVIDENCE: Final = 3.0
"""Gain in the logarithm of the likelihood from which a force is believed to act while the load rings; where nothing
else explains the readings, loss up to which it is."""

CLEARLY: Final = 2.0
"""Standard uncertainties that a decay rate is above zero at least."""

STRUCK: Final = 4.0
"""Mean square of a block of whitened residuals over the usual one from which something else happened in it."""

SLOWEST: Final = 4.0
"""Periods in the ringing below which a line is a drift."""

BLURRED: Final = 3.0
"""By how much more uncertain the decay rate may become by a line that is taken up."""


@dataclass(frozen=True, slots=True)
class Account:
    """What a record is made of.

    Attributes
    ----------
    ring
        The ringing, with the mean decay rate and frequency where they follow a law.
    dependence
        Test for a dependence on the amplitude; None where the ringing cannot tell.
    law
        What a law of the amplitude comes to; None where there is none.
    close
        Whether a further mode lies so close to the first that their ringing beats.
    whole
        First and last instant that there were readings of [s].
    broken
        Whether readings beyond a gap are left out, as a force that acts all along is not followed over it.
    """

    ring: Ring
    dependence: AmplitudeDependence | None
    law: AmplitudeLaw | None
    close: bool
    whole: tuple[float, float]
    broken: bool = False


def account(ring: Ring, time: Array, values: Array, *, onset: float) -> Account:
    """Return what a record is made of, from a first fit over the whole and the instant where it seems to begin."""
    whole = (float(time[0]), float(time[-1]))
    quick = _forced(ring, ring, (time, values), onset) if ring.colour > 1 else None
    if quick is not None and not _shows_more(quick) and _complete(ring).colour > 1:
        return _of_force(quick, time)
    first, close, bent = _richer(ring)
    found = freed(_widened(_shortened(_complete(_shortened(first))), first))
    forced = None
    if found.colour > COLOURED:
        # nothing else explains it: a force does, unless the readings speak against one
        forced = quick or _forced(ring, ring, (time, values), onset, evidence=-FORCE_EVIDENCE)
        if found.time.size < ring.time.size and forced is None:
            part = fit_ring(found.time, found.values, found, lines=(), bent=False)
            forced = _forced(part, found, (found.time, found.values), onset, evidence=-FORCE_EVIDENCE)
    if forced is not None:
        return _of_force(forced, time)
    dependence, found = amplitude_dependence(found, bent=bent if found is ring else None)
    law = None
    if found.bent:
        chosen = likeliest_law(found)
        lawful = by_law(found, chosen)
        found = lawful if decays_by(lawful, chosen) else fit_ring(found.time, found.values, found, lines=found.lines)
    if found.law is not None:
        found, law, dependence = levelled(found, found.law)
    if quick is not None and not decays(found):  # a law or a second mode that leads nowhere
        return _of_force(quick, time)
    return Account(found, dependence, law, close=close and len(found.lines) > 0, whole=whole)


def _of_force(ring: Ring, time: Array) -> Account:
    """The account of readings at these instants that a ring with a force gives."""
    first, last = np.searchsorted(time, ring.time[[0, -1]])
    beside = np.diff(time[max(first - 1, 0) : first + 1]), np.diff(time[last : last + 2])
    broken = any((gap > BROKEN / ring.frequency).any() for gap in beside)
    return Account(ring, None, None, close=False, whole=(float(time[0]), float(time[-1])), broken=broken)


def decays(ring: Ring) -> bool:
    """Whether the decay of a ringing is clearly more than its uncertainty."""
    return ring.decay > CLEARLY * float(np.sqrt(ring.covariance[0, 0]))


def _richer(ring: Ring) -> tuple[Ring, bool, Ring]:
    """The ring, or one with a law or with a second mode close by where that takes away much of what is left over.

    Done before anything else is looked for: what a bent ringing leaves over looks like lines beside the ringing.
    """
    bent, band = bent_fit(ring), RingBand(ring)
    gain = band.minus_log_likelihood(ring.residuals) - band.minus_log_likelihood(bent.residuals)
    if bent.squares > (1 - PLAIN) * ring.squares and gain < EVIDENCE / 2:
        return ring, False, bent
    chosen = likeliest_law(bent)
    law, two = by_law(ring, chosen), of_two_modes(ring)
    if two is not None and two.squares < law.squares - EVIDENCE * two.variance:
        return two, True, bent
    # a law whose search went astray, as beside a strong further mode, explains less than none
    return (law if law.squares < ring.squares and decays_by(law, chosen) else ring), False, bent


def _believed(forced: Ring, other: Ring, evidence: float) -> bool:
    """Whether a force explains a record better, by this evidence, than another fit of the same readings does.

    The other fit is given noise of any level near the ringing, so that it is no worse where that noise is a force.
    """
    if forced.force is None:
        raise AssertionError
    if other.decay <= 0 and other.colour > COLOURED:  # no ringing of a release, and not what was read
        return True
    left = other.residuals[np.isin(other.time, forced.time)]
    if left.size < forced.time.size:  # it leaves out what the force explains
        return True
    of_other = RingBand(forced).minus_log_likelihood(left)
    return forced.force.objective < of_other - evidence


def _behind_release(ring: Ring, time: Array, values: Array, onset: float) -> Ring | None:
    """What follows the release, as a free ringing: where it begins, and how high, a force hides."""
    period = 1 / ring.frequency
    fallen = _fall(time, values, ring)
    if fallen is not None:
        behind = fallen + CLEAR_OF * period
    elif ring.shape == "free":
        behind = ring.start
    else:
        start = ring.start + ring.duration
        behind = (onset if abs(start - onset) > FAR * period else max(start, onset)) + CLEAR_OF * period
    after = time >= behind
    time, values = _unbroken(time[after], values[after], period)
    if time.size < 64:
        return None
    w, decay = 2 * np.pi * ring.frequency, max(ring.decay, 1e-6 * ring.frequency)
    vector = np.array([decay, w])
    columns = columns_of(time, "free", vector, (), begin=float(time[0]))
    sizes, left = projected(columns, values)
    size = vector.size + sizes.size
    return replace(
        ring,
        shape="free",
        start=float(time[0]),
        duration=0.0,
        decay=decay,
        lines=(),
        bent=False,
        law=None,
        vector=vector,
        sizes=sizes,
        covariance=np.zeros((size, size)),
        time=time,
        values=values,
        residuals=left,
    )


def _unbroken(time: Array, values: Array, period: float) -> tuple[Array, Array]:
    """The readings, or where many are missing the part without a gap in which the most is read.

    What a force does in a gap is not known from what was read on both sides.
    """
    gaps = np.diff(time)
    breaks = np.flatnonzero(gaps > BROKEN * period)
    if not breaks.size or float(gaps[breaks].sum()) < MISSING * (time[-1] - time[0]):
        return time, values
    parts = zip(np.split(time, breaks + 1), np.split(values, breaks + 1), strict=True)
    return max(parts, key=lambda part: part[1].size * float(np.var(part[1])))


def _fall(time: Array, values: Array, ring: Ring) -> float | None:
    """Instant at which the level of the readings changes for good [s]; None where that is no more than their scatter.

    Means over periods, in which the ringing is gone, are split where two levels explain them best.
    """
    length = max(round(ring.rate / ring.frequency), 1)
    count = time.size // length
    if count < 8:
        return None
    means = values[: count * length].reshape(count, length).mean(axis=1)
    before = np.cumsum(means)[:-1]
    number = np.arange(1, count)
    step = (means.sum() - before) / (count - number) - before / number
    gain = step**2 * number * (count - number)
    place = int(np.argmax(gain[1:-1])) + 1
    left = np.concatenate(
        [means[: place + 1] - means[: place + 1].mean(), means[place + 1 :] - means[place + 1 :].mean()]
    )
    return float(time[(place + 1) * length]) if abs(step[place]) > LEVEL_CHANGE * left.std() else None


def _forced(
    ring: Ring, other: Ring, readings: tuple[Array, Array], onset: float, *, evidence: float = FORCE_EVIDENCE
) -> Ring | None:
    """The ring with a force that acts all along, where that explains the record better than another fit does."""
    free = _behind_release(ring, *readings, onset)
    found = None if free is None else driven(free)
    if found is None or not _believed(found, other, evidence) or _struck(found):
        return None
    for _ in range(MOST_LINES):
        line = residual_line(found)
        larger = None if line is None else driven(found, lines=(*found.lines, line))
        if larger is None or _odd(larger, found) or not _gains(larger, found):
            break
        found = larger
    if found.lines and not _believed(
        found, fit_ring(found.time, found.values, replace(found, force=None), lines=found.lines), evidence
    ):
        return None
    return found


def _gains(larger: Ring | None, ring: Ring) -> bool:
    """Whether a richer ring with a force explains a record better."""
    if larger is None or larger.force is None or ring.force is None:
        return False
    return larger.force.objective < ring.force.objective - EVIDENCE / 2


def _shows_more(ring: Ring) -> bool:
    """Whether a ring with a force may follow a law besides, or be of two modes."""
    if _gains(driven(ring, bent=True), ring):
        return True
    return any(_gains(driven(ring, lines=(*ring.lines, line)), ring) for line in close_lines(ring))


def _complete(ring: Ring) -> Ring:
    """Take up the lines that the residuals still show, one at a time."""
    for _ in range(MOST_LINES):
        line = residual_line(ring)
        if line is None:
            break
        larger = fit_ring(ring.time, ring.values, ring, lines=(*ring.lines, line))
        if _odd(larger, ring) or larger.squares > ring.squares - EVIDENCE * ring.variance:
            break
        ring = larger
    return ring


def _odd(larger: Ring, ring: Ring) -> bool:
    """Whether the last line of a fit is none, but a part of the ringing or of another line, or hides the decay."""
    line = larger.lines[-1]
    resolved = 1 / (float(larger.time[-1]) - max(larger.start, float(larger.time[0])))
    width = max(5 * larger.decay / (2 * np.pi), resolved)
    if abs(line.frequency - larger.frequency) < width:
        return True
    if any(abs(line.frequency - other.frequency) < resolved for other in larger.lines[:-1]):
        return True
    if line.frequency < SLOWEST * resolved:
        return True
    if any(not 0 <= one.decay < HEAVIEST * 2 * np.pi * one.frequency for one in larger.lines):
        return True
    blurred = larger.covariance[0, 0] > BLURRED**2 * ring.covariance[0, 0]
    return bool(blurred)


def _blocks(ring: Ring) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Where blocks of a few periods begin and end, and which of them the noise hardly makes."""
    length = max(64, round(3 * ring.rate / ring.frequency))
    blocks = np.array_split(ring.residuals, max(ring.time.size // length, 1))
    sizes = np.array([block.size for block in blocks])
    squares = np.array([block @ block for block in blocks])
    usual = max(float(np.median(squares / sizes)), 1e-300)
    unlikely = np.asarray(chdtrc(sizes, squares / usual)) < BLOCK_PROBABILITY
    return np.concatenate(([0], np.cumsum(sizes))), unlikely


def _struck(ring: Ring) -> bool:
    """Whether something happens while a force acts, which is no part of either: the ends are not looked at."""
    edges, _ = _blocks(ring)
    squares = np.array([np.mean(ring.residuals[i:j] ** 2) for i, j in pairwise(edges)])
    return bool(squares.size > 4 and squares[2:-2].max() > STRUCK * np.median(squares))


def _shortened(ring: Ring) -> Ring:
    """Cut the record where something else happens before or after the ringing.

    Blocks of residuals that do not fit count only behind two that do: a lack of fit that begins at the release itself
    is the model's, and its lines are looked for instead. The part is taken only where it tells the damping better than
    the whole does.
    """
    edges, unlikely = _blocks(ring)
    count = unlikely.size
    if count < 6 or ring.variance < (1e-9 * ring.amplitude) ** 2:
        return ring
    if ring.law is not None and ring.colour == 1:  # what varies is not near the ringing, and a law needs its length
        return ring
    home = min(int(np.searchsorted(edges, np.searchsorted(ring.time, ring.start), side="right")) - 1, count - 1)
    last = edges[home + 1 + _first_event(unlikely[home + 1 :])]
    first = edges[home - _first_event(unlikely[:home][::-1])]
    if first == 0 and last == ring.time.size:
        return ring
    part = slice(int(first), int(last))
    # lines found with the cut parts may be theirs: look for lines afresh
    cut = _complete(fit_ring(ring.time[part], ring.values[part], ring))
    return cut if cut.covariance[0, 0] < ring.covariance[0, 0] else ring


def _widened(ring: Ring, whole: Ring) -> Ring:
    """The fit over more of the record, where the lines found since explain what had been cut off."""
    if ring.time.size == whole.time.size or not ring.lines:
        return ring
    wider = _shortened(fit_ring(whole.time, whole.values, ring, lines=ring.lines))
    return wider if wider.time.size > ring.time.size and len(wider.lines) == len(ring.lines) else ring


def _first_event(unlikely: NDArray[np.bool_]) -> int:
    """Place of the first unlikely block behind two that are not, or the number of blocks."""
    for place in range(2, unlikely.size):
        if unlikely[place] and not unlikely[place - 2 : place].any():
            return place
    return unlikely.size
