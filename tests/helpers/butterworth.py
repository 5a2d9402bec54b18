"""Spectra of forces that fall off as a Butterworth filter."""

import numpy as np

from aerobalance.estimation.statespace.shaping_filter import ShapingFilter


def butterworth(order: int, *, cutoff: float, density: float) -> ShapingFilter:
    """Shaping filter of a Butterworth spectrum: a chain of sections, the last driven by noise, the first the force."""
    wc = 2 * np.pi * cutoff
    A, B = np.zeros((order, order)), np.zeros(order)
    B[-1] = wc * np.sqrt(density)
    if order == 1:
        return ShapingFilter(np.array([[-wc]]), B)
    poles = np.exp(1j * np.pi * (0.5 + (2 * np.arange(order // 2) + 1) / (2 * order)))
    for place, pole in zip(range(0, order, 2), poles[::-1], strict=True):  # the most damped section is the last
        A[place, place + 1] = wc
        A[place + 1, place : place + 2] = [-wc, 2 * wc * pole.real]
        if place + 2 < order:
            A[place + 1, place + 2] = wc
    return ShapingFilter(A, B)
