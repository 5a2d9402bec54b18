"""The law by which damping and frequency of a ringing load change with its amplitude, and what it comes to."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

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

APART: Final = (-4.0, -2.0, -1.0, 1.0, 2.0, 4.0)
"""Distances at which a second mode is looked for close to the first, in decay rates over 2 pi."""

TOLD: Final = 5.0
"""Least decay rate over its standard uncertainty where two modes are taken for what a ringing is made of."""


def by_a_law(ring: Ring) -> Ring:
    """Return the ring with the law of its amplitude that explains it best."""
    found = [fit_ring(ring.time, ring.values, ring, lines=ring.lines, bent=False, law=law) for law in LAWS]
    return min(found, key=lambda one: one.squares)


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
        u = float(np.sqrt(found.covariance[0, 0]))
        sound = found.decay > TOLD * u and found.lines[-1].decay > 0
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


def levelled(ring: Ring) -> tuple[Ring, AmplitudeLaw, AmplitudeDependence]:
    """Return a ring with a law as one with the mean decay rate and frequency, what the law comes to, and its changes.

    The mean is weighed by the squared amplitude, as a fit of one number does it. What the two are over the amplitudes
    from the first to the least, or to a tenth, is taken as evenly spread about it and is in their uncertainty.
    """
    if ring.law is None:
        raise ValueError("the ring has no law")
    law = ring.law
    since = ring.time - ring.start - ring.duration
    since = since[since > 0]
    places = np.array([0, 1, ring.vector.size - 2, ring.vector.size - 1])
    at = ring.vector[places]
    end = float(envelope_of(since[-1:], at[0], at[2], law.damping)[0])
    noise = np.sqrt(ring.variance) / (ring.amplitude or np.inf)
    sizes = np.array([1.0, min(max(end, LEAST, float(noise)), 1.0)])

    def results(values: Array) -> Array:
        """Mean decay rate and angular frequency, and both at the two amplitudes, shape (6,)."""
        decay, w, share, stiffer = values
        size = envelope_of(since, decay, share, law.damping)
        weight = np.mean(size**2)
        loss = 1 - share + share * np.mean(size ** (2 + law.damping)) / weight
        means = [decay * loss, w * (1 + stiffer * np.mean(size ** (2 + law.frequency)) / weight)]
        ends = [decay * (1 - share + share * sizes**law.damping), w * (1 + stiffer * sizes**law.frequency)]
        return np.concatenate([means, *ends])

    steps = np.diag(1e-5 * np.array([abs(at[0]), abs(at[1]), 1.0, 1e-2]))
    slopes = np.array([(results(at + step) - results(at - step)) / (2 * step.sum()) for step in steps]).T
    decay, w, first, last, fast, slow = results(at)
    every = slopes @ ring.covariance[np.ix_(places, places)] @ slopes.T
    u = np.sqrt(np.diag(every))
    turn = np.eye(ring.covariance.shape[0])
    turn[:2] = 0.0
    turn[:2, places] = slopes[:2]
    covariance = turn @ ring.covariance @ turn.T
    # a spring that changes by a part bends the waveform too, and so hides as much of the damping
    covariance[0, 0] += ((first - last) ** 2 + (decay * (fast - slow) / w) ** 2) / 12
    covariance[1, 1] += (fast - slow) ** 2 / 12
    rates = np.array([fast, slow])
    found = AmplitudeLaw(
        powers=law,
        amplitude=sizes * ring.amplitude,
        damping_ratio=np.array([first, last]) / rates,
        u_damping_ratio=u[2:4] / rates,
        frequency=rates / (2 * np.pi),
        u_frequency=u[4:] / (2 * np.pi),
    )
    apart = np.zeros((2, 6))
    apart[0, 2:4], apart[1, 4:] = (1.0, -1.0), (1.0, -1.0)
    change, u_change = apart @ results(at), np.sqrt(np.diag(apart @ every @ apart.T))
    dependence = AmplitudeDependence(
        float(change[0] / decay), float(u_change[0] / decay), float(change[1] / w), float(u_change[1] / w)
    )
    vector = ring.vector.copy()
    vector[:2] = decay, w
    mean = replace(ring, vector=vector, covariance=covariance, decay=float(decay), frequency=float(w / (2 * np.pi)))
    return mean, found, dependence
