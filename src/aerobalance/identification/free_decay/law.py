"""The law by which damping and frequency of a ringing load change with its amplitude, and what it comes to."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct

from aerobalance.identification.free_decay.amplitude_dependence import AmplitudeDependence
from aerobalance.identification.free_decay.ring_fit import fit_ring
from aerobalance.identification.free_decay.waveform import (
    DecayLine,
    Law,
    Ring,
    envelope_of,
)
from aerobalance.recording.channel import Array

LAWS: Final = (Law(-1, 2), Law(1, 1), Law(2, 2))
"""Laws that are tried: dry friction, what goes with the amplitude, and what goes with its square."""

LEAST: Final = 0.1
"""Amplitude over the first down to which the law counts for what the damping is uncertain by."""

SLOW: Final = 0.25
"""Frequency over that of the ringing below which readings wander."""

FEWEST: Final = 4
"""Ordinates below it that are needed to tell."""

WANDERS: Final = 3.0
"""Their level over that of white noise from which they are no noise."""

MEDIAN: Final = 0.455
"""Median of the square of a standard normal deviate [1]."""

APART: Final = (-4.0, -2.0, -1.0, 1.0, 2.0, 4.0)
"""Distances at which a second mode is looked for close to the first, in decay rates over 2 pi."""

TOLD: Final = 5.0
"""Least decay rate over its standard uncertainty where two modes are taken for what a ringing is made of."""


def without_wander(ring: Ring) -> Ring:
    """Return the ring without what wanders far more slowly than it rings, where that is more than white noise.

    The squares of two waveforms differ by little of what they are: a zero that wanders, whose start and end leave
    something at every frequency, would choose between them.
    """
    lines = dct(ring.residuals, norm="ortho")
    count = int(2 * SLOW * ring.frequency * (ring.time[-1] - ring.time[0]))
    slow = lines[2:count]  # offset and drift are fitted
    if slow.size < FEWEST or np.mean(slow**2) < WANDERS * np.median(lines[count:] ** 2) / MEDIAN:
        return ring
    lines[:2], lines[count:] = 0.0, 0.0
    wander = idct(lines, norm="ortho")
    return replace(ring, values=ring.values - wander, residuals=ring.residuals - wander)


def likeliest_law(ring: Ring) -> Law:
    """Return the law of its amplitude that explains a ring best."""
    still = without_wander(ring)
    return LAWS[int(np.argmin([by_law(still, law).squares for law in LAWS]))]


def by_law(ring: Ring, law: Law) -> Ring:
    """Return the ring with a decay rate and a frequency that change with the amplitude by a law."""
    if ring.law not in {None, law}:
        ring = replace(ring, law=None, vector=ring.vector[:-2])
    return fit_ring(ring.time, ring.values, ring, lines=ring.lines, bent=False, law=law)


def close_lines(ring: Ring) -> list[DecayLine]:
    """Return first guesses of a further mode close to the first, none where the ringing does not fall."""
    lines = [DecayLine(ring.frequency + apart * ring.decay / (2 * np.pi), ring.decay) for apart in APART]
    return [line for line in lines if line.frequency > 0] if ring.decay > 0 else []


def of_two_modes(ring: Ring) -> Ring | None:
    """Return the ring with a further mode close to the first that explains it best; None where none is told."""
    best: Ring | None = None
    width = ring.decay / (2 * np.pi)
    # a weak one lies on either side; of two that are as strong the ring found is in the middle
    for shift, apart in ((-width, width), (0.0, width), (0.0, -width)) if ring.decay > 0 else ():
        line = DecayLine(ring.frequency + apart, ring.decay)
        begun = replace(ring, frequency=ring.frequency + shift)
        found = fit_ring(ring.time, ring.values, begun, lines=(*ring.lines, line), bent=False)
        variance = float(found.covariance[0, 0])  # below zero by rounding where two modes are one
        told = variance >= 0 and found.decay > TOLD * np.sqrt(variance)
        sound = told and found.lines[-1].decay > 0
        if sound and (best is None or found.squares < best.squares):
            best = found
    return best


@dataclass(frozen=True, slots=True)
class AmplitudeLaw:
    """Damping and frequency of a ringing load at its first amplitude and at the least.

    Attributes
    ----------
    powers
        Powers n and m of the amplitude with which the decay rate and the frequency change.
    amplitude
        The two amplitudes [unit of the load], shape (2,).
    damping_ratio, u_damping_ratio
        Damping ratio there and its standard uncertainty [1], shape (2,).
    frequency, u_frequency
        Frequency there and its standard uncertainty [Hz], shape (2,).
    """

    powers: Law
    amplitude: Array
    damping_ratio: Array
    u_damping_ratio: Array
    frequency: Array
    u_frequency: Array


def levelled(ring: Ring, chosen: Law) -> tuple[Ring, AmplitudeLaw, AmplitudeDependence]:
    """Return a ring by a law as one with the mean decay rate and frequency, what the law comes to, and its changes.

    The mean is weighed by the squared amplitude, as a fit of one number does it. What the two are over the amplitudes
    from the first to the least, or to a tenth, is taken as evenly spread about it and is in their uncertainty; and so
    is what other laws come to, as far as the readings leave open which it is.
    """
    still = without_wander(ring)
    ring = ring if still is ring else by_law(still, chosen)
    since = ring.time - ring.start - ring.duration
    since = since[since > 0]
    places = _places(ring)
    at = ring.vector[places]
    end = float(envelope_of(since[-1:], at[0], at[2], chosen.damping)[0])
    noise = np.sqrt(ring.variance) / (ring.amplitude or np.inf)
    sizes = np.array([1.0, min(max(end, LEAST, float(noise)), 1.0)])

    steps = np.diag(1e-5 * np.array([abs(at[0]), abs(at[1]), 1.0, 1e-2]))
    up, down = ([_comes_to(at + sign * step, chosen, since, sizes) for step in steps] for sign in (1, -1))
    slopes = np.array([(a - b) / (2 * step.sum()) for a, b, step in zip(up, down, steps, strict=True)]).T
    found = _comes_to(at, chosen, since, sizes)
    decay, w, first, last, fast, slow = found
    every = slopes @ ring.covariance[np.ix_(places, places)] @ slopes.T
    open_laws = _of_other_laws(ring, chosen, found, since, sizes)
    every = every + open_laws
    u = np.sqrt(np.diag(every))
    turn = np.eye(ring.covariance.shape[0])
    turn[:2] = 0.0
    turn[:2, places] = slopes[:2]
    covariance = turn @ ring.covariance @ turn.T
    covariance[:2, :2] += open_laws[:2, :2]
    # a spring that changes by a part bends the waveform too, and so hides as much of the damping
    covariance[0, 0] += ((first - last) ** 2 + (decay * (fast - slow) / w) ** 2) / 12
    covariance[1, 1] += (fast - slow) ** 2 / 12
    rates = np.array([fast, slow])
    law = AmplitudeLaw(
        powers=chosen,
        amplitude=sizes * ring.amplitude,
        damping_ratio=np.array([first, last]) / rates,
        u_damping_ratio=u[2:4] / rates,
        frequency=rates / (2 * np.pi),
        u_frequency=u[4:] / (2 * np.pi),
    )
    apart = np.zeros((2, 6))
    apart[0, 2:4], apart[1, 4:] = (1.0, -1.0), (1.0, -1.0)
    change, u_change = apart @ found, np.sqrt(np.diag(apart @ every @ apart.T))
    dependence = AmplitudeDependence(
        float(change[0] / decay), float(u_change[0] / decay), float(change[1] / w), float(u_change[1] / w)
    )
    vector = ring.vector.copy()
    vector[:2] = decay, w
    mean = replace(ring, vector=vector, covariance=covariance, decay=float(decay), frequency=float(w / (2 * np.pi)))
    return mean, law, dependence


def decays_by(ring: Ring, law: Law) -> bool:
    """Whether a ring by a law decays on the average: a search that goes astray may end in a rise, or in no number."""
    since = ring.time - ring.start - ring.duration
    since = since[since > 0]
    if not since.size:
        return False
    with np.errstate(over="ignore", invalid="ignore"):
        found = _comes_to(ring.vector[_places(ring)], law, since, np.array([1.0, LEAST]))
    return bool(np.isfinite(found).all() and found[0] > 0)


def _places(ring: Ring) -> NDArray[np.intp]:
    """Places of decay rate, angular frequency and the two numbers of the law among the nonlinear parameters."""
    return np.array([0, 1, ring.vector.size - 2, ring.vector.size - 1])


def _comes_to(values: Array, law: Law, since: Array, sizes: Array) -> Array:
    """Mean decay rate and angular frequency, and both at two amplitudes over the first, (2,), shape (6,)."""
    decay, w, share, stiffer = values
    size = envelope_of(since, decay, share, law.damping)
    weight = np.mean(size**2)
    loss = 1 - share + share * np.mean(size ** (2 + law.damping)) / weight
    means = [decay * loss, w * (1 + stiffer * np.mean(size ** (2 + law.frequency)) / weight)]
    ends = [decay * (1 - share + share * sizes**law.damping), w * (1 + stiffer * sizes**law.frequency)]
    return np.concatenate([means, *ends])


def _of_other_laws(ring: Ring, chosen: Law, found: Array, since: Array, sizes: Array) -> Array:
    """Covariance of what a ring comes to by laws that explain the readings nearly as well, shape (6, 6).

    Each law counts by its likelihood; what is left over near the ringing is the noise that matters.
    """
    laws = [one for one in LAWS if one != chosen]
    others = [by_law(ring, one) for one in laws]
    lost = np.array([other.squares - ring.squares for other in others]) / (ring.variance * max(ring.colour, 1.0))
    weight = np.exp(-0.5 * np.maximum(lost, 0.0))
    covariance = np.zeros((found.size, found.size))
    for other, law, share in zip(others, laws, weight / (1 + weight.sum()), strict=True):
        apart = _comes_to(other.vector[_places(other)], law, since, sizes) - found
        covariance += share * np.outer(apart, apart)
    return covariance
