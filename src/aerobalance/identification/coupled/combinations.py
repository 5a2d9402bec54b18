"""Modes and the combinations of loads that excite each of them."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from aerobalance.identification.coupled.free_response import Complex, FreeMotion
from aerobalance.recording.channel import Array

STILL: Final = 100.0
"""Energy of a motion over the noise of one reading below which it is not seen."""


def combination_text(weights: Array, components: tuple[str, ...]) -> str:
    """A combination of loads in words, largest weight 1, small ones left out."""
    weights = weights / weights[np.argmax(np.abs(weights))]
    kept = [number for number in np.argsort(-np.abs(weights)) if abs(weights[number]) >= 0.1]
    first, *others = kept
    text = str(components[first])
    for number in others:
        text += f" {'+' if weights[number] > 0 else '-'} {abs(weights[number]):.2f} {components[number]}"
    return text


def plainest(combinations: Array) -> Array:
    """The same space of combinations, each with a component of its own, shape (k, n)."""
    rows = combinations / np.linalg.norm(combinations, axis=1, keepdims=True)
    for number in range(len(rows)):
        place = np.unravel_index(np.argmax(np.abs(rows[number:])), rows[number:].shape)
        rows[[number, number + place[0]]] = rows[[number + place[0], number]]
        rows[number] /= rows[number, place[1]]
        others = np.arange(len(rows)) != number
        rows[others] -= np.outer(rows[others, place[1]], rows[number])
    return np.asarray(rows)


def first_release_for(combinations: Array, components: tuple[str, ...]) -> str:
    """The component along which a release moves these combinations most."""
    return components[int(np.argmax(np.sum(combinations**2, axis=0)))]


def combination_of(motion: FreeMotion, mode: int) -> Array:
    """Combination of loads that sets off one mode and no other, shape (n,); `mode` counts the pairs of poles.

    With internal coordinates there is none: then that with which the mode takes the largest part of what is set off.
    """
    up, _ = pairs(motion)
    if motion.size > motion.components:
        return _strongest(
            motion.participation[up, : motion.components] * np.linalg.norm(motion.felt[:, up], axis=0)[:, None], mode
        )
    others = np.delete(motion.shapes[:, up], mode, axis=1)
    if others.shape[1] == 0:
        return np.ones(1)
    left = np.linalg.svd(np.hstack([others.real, others.imag]))[0]
    return left[:, -1]


def _strongest(amplitudes: Complex, mode: int) -> Array:
    """Combination of loads for which one mode's amplitude is largest over the root sum of squares of all."""
    one = np.real(np.outer(amplitudes[mode].conj(), amplitudes[mode]))
    every = np.real(amplitudes.conj().T @ amplitudes)
    return np.asarray(eigh(one, every)[1][:, -1])


def pairs(motion: FreeMotion) -> tuple[NDArray[np.intp], Array]:
    """Places of the oscillating poles, one of each pair, the slowest first, and their sizes."""
    up = np.flatnonzero(motion.poles.imag > 0)
    order = np.argsort(np.abs(motion.poles[up]))
    return up[order], np.abs(motion.poles[up[order]])
