"""The search for further modes in what a fit of a shaken balance leaves: where one would answer the ground motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.identification.base_excitation.frf_model import Parameters, Problem, point
from aerobalance.identification.base_excitation.maximum_likelihood import (
    Estimate,
    first_weights,
    gain_over,
    maximise,
    rough_mode,
)
from aerobalance.identification.base_excitation.spectra import Complex, Spectra
from aerobalance.identification.free_decay.waveform import HEAVIEST
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError


@dataclass(frozen=True, slots=True)
class FurtherModeSettings:
    """Thresholds of the search for further modes.

    Attributes
    ----------
    evidence
        Log-likelihood that a further mode must gain. It brings five parameters, so Gaussian noise alone gains as much
        with a probability of 1.4e-9 at one place; a record has up to some thousand places, which makes a false mode in
        less than one record in 100,000.
    hint
        Log-likelihood that the search, on a grid and with the share alone free, must promise before a fit is tried.
    losses
        Losses 2 zeta that are tried.
    places
        Places that are tried until one of them carries a mode.
    apart
        Distance of these places, as the log of a frequency.
    groups
        Groups of neighbouring frequencies that the search sums over, at most.
    """

    evidence: float = 25.0
    hint: float = 10.0
    losses: tuple[float, ...] = (0.004, 0.012, 0.035, 0.1, 0.3)
    places: int = 3
    apart: float = 0.1
    groups: int = 4096


SETTINGS: Final = FurtherModeSettings()
"""Thresholds that are used."""


def with_further_modes(problem: Problem, estimate: Estimate, *, most: int, name: str) -> Estimate:
    """Take up further modes, one at a time, while each gains clearly and is physical; the strongest leads."""
    for _ in range(most):
        larger = one_more_mode(problem, estimate, name=name)
        if larger is None:
            break
        estimate = larger
    return estimate


def one_more_mode(problem: Problem, estimate: Estimate, *, name: str) -> Estimate | None:
    """Fit one further mode where the residual follows the ground motion most, or say that there is none.

    Of several places the first is taken that leaves nothing, or the one that leaves least.
    """
    best = None
    for start in _starts(problem, estimate, name=name):
        try:
            larger = _led(problem, maximise(problem, name=name, start=start), name=name)
            gain = gain_over(problem, larger, smaller=estimate, name=name)
        except FitError:  # a mode that does not settle is none
            continue
        if gain < SETTINGS.evidence or not _physical(larger, problem.spectra):
            continue
        if larger.adequate:
            return larger
        if best is None or larger.correlation < best.correlation:
            best = larger
    return best


def _starts(problem: Problem, estimate: Estimate, *, name: str) -> list[Parameters]:
    """Modes fitted so far with a further one at one of the places where it promises most."""
    if estimate.further_modes or estimate.adequate:
        return _likely_modes(problem, estimate.parameters)
    # Where one mode is far from the truth, the most likely one may be no mode of the balance at all.
    return _likely_modes(problem, rough_mode(problem, name=name)) or _likely_modes(problem, estimate.parameters)


def _led(problem: Problem, estimate: Estimate, *, name: str) -> Estimate:
    """The same with the mode of the largest share in the first place."""
    strongest = int(np.argmax(np.abs(estimate.parameters.shares)))
    if strongest == 0:
        return estimate
    return maximise(problem, name=name, start=estimate.parameters.led_by(strongest))


def _physical(estimate: Estimate, spectra: Spectra) -> bool:
    """Whether every further mode lies within the band, is lightly damped, and carries less than the whole load."""
    return all(
        spectra.frequency[0] < mode.natural_frequency < spectra.frequency[-1]
        and 0 < mode.damping_ratio < HEAVIEST
        and abs(mode.share) < 1
        for mode in estimate.further_modes
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Remainder:
    """What the fit leaves, summed over groups of neighbouring frequencies; p physical parameters are free.

    Attributes
    ----------
    frequency
        Centre of every group [Hz], shape (g,).
    pushed
        Load at rest per ground acceleration, delayed, shape (g,).
    first
        Response 1/D of the first mode, shape (g,).
    power
        Weighted power of the ground motion, shape (g,).
    score
        Weighted cross power of ground motion and residual, shape (g,).
    known
        Weighted cross power of ground motion and Jacobian, shape (g, p).
    curvature, slope
        Of the likelihood by the p parameters, shapes (p, p) and (p,).
    """

    frequency: Array
    pushed: Complex
    first: Complex
    power: Array
    score: Complex
    known: Complex
    curvature: Array
    slope: Array

    @classmethod
    def of(cls, problem: Problem, parameters: Parameters) -> _Remainder:
        spectra = problem.spectra
        here = point(problem, parameters, weights=first_weights(problem, parameters))
        group = (
            np.arange(spectra.frequency.size) * min(SETTINGS.groups, spectra.frequency.size) // spectra.frequency.size
        )
        starts = np.flatnonzero(np.diff(group, prepend=-1))

        def total(values: Array | Complex) -> Array | Complex:
            return np.add.reduceat(values, starts, axis=0)

        free = [i for i in range(parameters.physical) if not (i == 3 and problem.delay is not None)]
        weighted = np.conj(here.ground) / np.sqrt(here.variance)
        jacobian = here.jacobian[:, free]
        left = here.residual / np.sqrt(here.variance)
        centre = np.asarray(total(spectra.frequency) / np.diff(starts, append=group.size), dtype=np.float64)
        w, values = 2 * np.pi * centre, parameters.values
        r = w / np.exp(values[1])
        return cls(
            frequency=centre,
            pushed=-np.exp(values[0] - 1j * w * values[3] / parameters.reference),
            first=1 / (1 - r**2 + 1j * r * values[2]),
            power=np.real(total(np.abs(weighted) ** 2)),
            score=np.asarray(total(weighted * left)),
            known=np.asarray(total(weighted[:, None] * jacobian)),
            curvature=np.real(jacobian.conj().T @ jacobian),
            slope=np.real(jacobian.conj().T @ left),
        )

    def gains(self, frequency: Array, loss: float) -> tuple[Array, Array]:
        """Log-likelihood gained by a further mode at each frequency [Hz], and its most likely share, shape (n,) each.

        The share is free, and what the parameters already fitted can do is left to them.
        """
        r = self.frequency / frequency[:, None]
        change = np.conj(self.pushed * (1 / (1 - r**2 + 1j * r * loss) - self.first))
        along = np.real(change @ self.known)
        power = np.abs(change) ** 2 @ self.power
        usual = np.linalg.lstsq(self.curvature, np.column_stack([along.T, self.slope]), rcond=1e-14)[0]
        score = np.real(change @ self.score) - along @ usual[:, -1]
        own = power - np.sum(along * usual[:, :-1].T, axis=1)
        share = np.where(own > 1e-3 * power, score / np.maximum(own, 1e-300), 0.0)
        return share * score, share


def _likely_modes(problem: Problem, parameters: Parameters) -> list[Parameters]:
    """Parameters with one further mode where it promises most, and at the next best places, the best first."""
    remainder = _Remainder.of(problem, parameters)
    low, high = float(problem.spectra.frequency[0]), float(problem.spectra.frequency[-1])
    tried = []
    for loss in SETTINGS.losses:
        frequencies = np.geomspace(low, high, 2 + int(np.log(high / low) / (0.7 * loss)))
        for part in np.array_split(frequencies, 1 + frequencies.size // 128):
            gains, shares = remainder.gains(part, loss)
            tried.append(np.column_stack([gains, part, np.full(part.size, loss), shares]))
    every = np.concatenate(tried)
    every = every[every[:, 0] > SETTINGS.hint]
    starts: list[Parameters] = []
    while every.size and len(starts) < SETTINGS.places:
        _, frequency, loss, share = every[np.argmax(every[:, 0])]
        starts.append(parameters.with_mode(2 * np.pi * frequency, loss=loss, share=share))
        every = every[np.abs(np.log(every[:, 1] / frequency)) > SETTINGS.apart]
    return starts
