"""Modes of coupled dynamics that have moved: what the ringing of all components says, and the reading of one.

All modes are moved together first: a single one that seems to have moved may be a narrow band of the load. Where a
load excites one alone, the reading of one component is asked as that of a single component is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.estimation.checks.changing_resonance import calm_stretch
from aerobalance.estimation.checks.channel_rows import Rows
from aerobalance.estimation.checks.evidence import evidence_in
from aerobalance.estimation.checks.moved_dynamics import Moved
from aerobalance.estimation.checks.narrow_load import gain_over_loads
from aerobalance.estimation.checks.near_resonance import near_resonance
from aerobalance.estimation.checks.ringing import RingingSpectra, most_samples
from aerobalance.estimation.checks.spoken import SETTINGS as RESONANCE
from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.estimation.observation import Observation
from aerobalance.estimation.record import FEWEST_SAMPLES
from aerobalance.estimation.result import ComponentForce
from aerobalance.estimation.spectra.steady_tones import without_tones
from aerobalance.recording.channel import Array
from aerobalance.recording.side_by_side import side_by_side


@dataclass(frozen=True, slots=True)
class MovedModeSettings:
    """What is tried, and from which evidence on it is believed.

    Attributes
    ----------
    moved
        Gain in log-likelihood, beside the band that brings most, that modes which have moved must bring: narrow bands
        of the load brought up to 34, more than this in one of 60 records.
    neighbors
        Bands, one beside the other, in which a narrow band of the load shows: half an octave of them.
    decisive_apart
        Gain that modes which have moved must bring beside the neighbors that bring most. Of 300 records that agree,
        220 of them of narrow bands, 298 had less than 1 and one had 2.8.
    open_from, open_half, open_steepness
        The same gain from which on the record leaves it open whether modes have moved, at which it is as likely as
        not, and how fast that grows.
    shifts, far_shifts, dampings
        Changes of the logarithm of all natural frequencies that are tried, up and down, those beyond where the noise
        has a color, which a force elsewhere may be taken for, and factors of all damping ratios.
    tries
        Dynamics that are tried at most to come closer to the best.
    farthest
        Logarithm of the largest change of a frequency and of a damping ratio that is looked for, either way.
    against
        Loss in log-likelihood in bands that modes which have moved make less likely, over the gain in the others, from
        which on they are not believed: of modes that have moved by 3 % it is 0.1 to 0.15, where a record has power far
        above its modes that no force makes 0.45 and more.
    as_expected
        Changes of the logarithms of natural frequency, over the damping ratio, and of damping ratio below which the
        resonance of a reading is the one that is expected: no finer than it is looked for.
    as_damped
        Change of the logarithm of its damping ratio up to which one mode alone is believed to have moved: a narrow
        band of the load, or the edge of one, is as a resonance with another damping.
    alone_about
        Logarithm of frequencies over that of one mode within which bands speak of its move alone.
    alone_shifts
        Changes of the logarithm of its frequency that are tried, up and down.
    alone_least
        Gain in log-likelihood that its move must bring at least, over the dynamics as they are.
    alone_clear
        Share of the ordinates about both frequencies that are clear of noise and leakage, from which they are asked.
    alone_fewest
        Ordinates within twice the move either side of the mode from which it is resolved: a move by four of them, as a
        window spreads a line over two either side.
    alone_open_from, alone_half, alone_decisive
        Gain over a narrow band of one load from which on the record leaves it open whether the mode has moved, at
        which it is as likely as not, and from which on it is believed. Between them its odds are those of the
        likelihoods, the load's of one number more and of a component and an order that were chosen. Of 515 records
        whose modes have not moved, 48 of them with a narrow band beside a mode and 280 with noise of a color, two were
        above zero, by 1.3 and 2.8; of 56 with one mode moved by 2 to 7 %, 46 were at 4 and above, and one below zero.
        Of 16 with one moved by 3 % that no other speaks for, 4 were above 4, and 5 between -0.4 and -3.
    told, told_damping
        Changes of the logarithms of a natural frequency and a damping ratio from which they are told.
    """

    moved: float = 25.0
    neighbors: int = 4
    decisive_apart: float = 8.0
    open_from: float = 4.0
    open_half: float = 5.5
    open_steepness: float = 0.8
    shifts: tuple[float, ...] = (0.01, 0.02, 0.04, 0.08, 0.16, 0.25, 0.35, 0.5)
    far_shifts: tuple[float, ...] = tuple(0.55 + 0.05 * place for place in range(18))
    dampings: tuple[float, ...] = (0.4, 2.5)
    tries: int = 40
    farthest: tuple[float, float] = (2.0, 12.0)
    against: float = 0.3
    as_expected: tuple[float, float] = (0.4, 0.5)
    as_damped: float = 1.0
    alone_about: float = 0.25
    alone_shifts: tuple[float, ...] = (0.01, 0.02, 0.03, 0.045, 0.06, 0.08)
    alone_least: float = 5.0
    alone_clear: float = 0.9
    alone_fewest: int = 16
    alone_open_from: float = -6.0
    alone_half: float = -3.0
    alone_decisive: float = 4.0
    told: float = 0.001
    told_damping: float = 0.3


SETTINGS: Final = MovedModeSettings()
"""Settings that are used."""


Evidence = Callable[[Moved], Array]
"""Evidence of moved modes in every band."""


@dataclass(frozen=True, slots=True, eq=False)
class OtherShapes:
    """What the ringing of coupled components speaks for.

    Attributes
    ----------
    kind
        ``"swapped sign"``, ``"swapped channels"``, ``"natural frequency"`` or ``"damping ratio"``.
    places
        Rows of the channels that are exchanged; none where modes have moved.
    rows
        The rows that it speaks for.
    gain
        Gain in log-likelihood.
    moved
        Modes that have moved; None where channels are exchanged.
    probability
        Probability of it [1]; below one the record leaves it open.
    """

    kind: str
    places: tuple[int, ...]
    rows: Rows
    gain: float
    moved: Moved | None = None
    probability: float = 1.0

    @classmethod
    def of_moved(cls, moved: Moved, gain: float) -> OtherShapes:
        """Modes that have clearly moved, by what of them has changed most plainly."""
        frequency, damping = np.max(np.abs(moved.changes), axis=0)
        damped = frequency <= SETTINGS.told and damping >= SETTINGS.told_damping
        return cls("damping ratio" if damped else "natural frequency", (), moved.rows, gain, moved)


def gain_of(evidence: Array, known: Array) -> float:
    """Gain in log-likelihood over what is known, less that of the band that brings most.

    A narrow band or the edge of a load is in one band, and looks there as modes do that are elsewhere.
    """
    gains = evidence - known
    return float(np.sum(gains) - max(np.max(gains), 0.0))


def gain_apart(evidence: Array, known: Array) -> float:
    """Gain in log-likelihood over what is known, less that of the neighboring bands that bring most.

    A narrow band of the load shows in these alone, modes that have moved show at all that ring.
    """
    gains = evidence - known
    neighbors = np.convolve(gains, np.ones(min(SETTINGS.neighbors, gains.size)), mode="valid")
    return float(np.sum(gains) - max(np.max(neighbors), 0.0))


def contradicted(evidence: Array, known: Array) -> bool:
    """Whether bands speak against what others speak for: modes that have moved are likelier wherever they are."""
    gains = evidence - known
    return float(-np.sum(np.minimum(gains, 0.0))) > SETTINGS.against * float(np.sum(np.maximum(gains, 0.0)))


def moved_together(
    ringing: RingingSpectra,
    dynamics: CoupledDynamics,
    known: Array,
    *,
    least: float,
    far: bool = False,
) -> OtherShapes | None:
    """Return the moved modes that a record speaks for, where that brings more than other explanations.

    All are moved together first: a single one that seems to have moved may be a narrow band of the load.

    Parameters
    ----------
    ringing
        The spectra of the record.
    dynamics
        The dynamics that it was read with.
    known
        Evidence of these in every band, shape (bands,).
    least
        Gain that they must bring.
    far
        Whether they are looked for far from those of the dynamics.
    """
    if not dynamics.has_one_mode_each:
        return None
    own, everything = Moved.none(dynamics), slice(None)
    seen_with = partial(evidence_of, ringing)
    sizes = (*SETTINGS.shifts, *(SETTINGS.far_shifts if far else ()))
    shifts = [(sign * size, 0.0) for size in sizes for sign in (-1, 1)]
    shifts += [(0.0, float(np.log(factor))) for factor in SETTINGS.dampings]
    tried = [own.by(everything, np.array(step)) for step in shifts]
    evidence = side_by_side(seen_with, tried)
    gains = [gain_of(one, known) for one in evidence]
    if max(gains) < 0.5 * least and max(gain_apart(one, known) for one in evidence) < 0.5 * SETTINGS.open_from:
        return None
    found = closer(seen_with, own, everything, tried[int(np.argmax(gains))])
    seen = seen_with(found)
    gain, apart = gain_of(seen, known), gain_apart(seen, known)
    narrow = gain < least or (apart < SETTINGS.open_from and gain < 2 * least)
    if (narrow and apart < SETTINGS.open_from) or not found.ringing.any() or contradicted(seen, known):
        return None
    if narrow and apart < SETTINGS.decisive_apart:
        probability = float(expit(SETTINGS.open_steepness * (apart - SETTINGS.open_half)))
        return OtherShapes("natural frequency", (), found.rows, gain, found, probability)
    for place in range(len(found.changes)):
        nearer = closer(seen_with, found, place, found)
        found = nearer if nearer.ringing[place] else found
    return OtherShapes.of_moved(found, gain)


def evidence_of(ringing: RingingSpectra, moved: Moved) -> Array:
    """Return the evidence of moved modes in every band, (bands,); none where a balance with them cannot be."""
    try:
        return ringing.evidence(moved.rows)
    except (ValueError, np.linalg.LinAlgError):
        return np.full(ringing.bands.size, -np.inf)


def closer(evidence: Evidence, before: Moved, place: int | slice, first: Moved) -> Moved:
    """Return the likeliest change of modes, one or all, near a first guess."""
    start = first.changes[place].reshape(-1, 2)[0] - before.changes[place].reshape(-1, 2)[0]
    size = np.array([max(0.3 * abs(float(start[0])), 0.003), 0.3])

    def lost(change: Array) -> float:
        return -float(np.sum(evidence(before.by(place, start + change * size))))

    simplex = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    # where nothing rings it would go on for ever
    low, high = ((side * np.array(SETTINGS.farthest) - start) / size for side in (-1.0, 1.0))
    most, within = SETTINGS.tries, list(zip(low.tolist(), high.tolist(), strict=True))
    best = minimize(
        lost,
        np.zeros(2),
        method="Nelder-Mead",
        bounds=within,
        options={"maxfev": most, "initial_simplex": simplex},
    )
    return before.by(place, start + best.x * size)


def moved_alone(ringing: RingingSpectra, dynamics: CoupledDynamics) -> OtherShapes | None:
    """Return the one mode that has moved, where that is likelier than a narrow band of any load there; or None.

    Rows that take out a ringing that is not there take as much of the force, and what rings elsewhere swings in all
    forces in the proportions of the mode. A narrow band of the load makes one force swing as much as a mode elsewhere
    does, and leaves no hole. Where one load acts in all, as a gust or a release, a mode elsewhere adds a second one.

    Parameters
    ----------
    ringing
        The spectra of the record.
    dynamics
        The dynamics that it was read with.
    """
    if not dynamics.has_one_mode_each:
        return None
    own = Moved.none(dynamics)

    def found_of(place: int) -> OtherShapes | None:
        mode = dynamics.modes[place]
        about = ringing.near(mode.natural_frequency, within=SETTINGS.alone_about)
        if about is None:
            return None
        evidence = partial(evidence_of, about)
        known = evidence(own)

        def gain_of_one(moved: Moved) -> float:
            return float(np.sum(evidence(moved) - known))

        shifts = [sign * size for size in SETTINGS.alone_shifts for sign in (-1, 1)]
        tried = [own.by(place, np.array([shift, 0.0])) for shift in shifts]
        gains = [gain_of_one(one) for one in tried]
        if max(gains) < 0.5 * SETTINGS.alone_least:
            return None
        moved = closer(evidence, own, place, tried[int(np.argmax(gains))])
        shift, damping = moved.changes[place]
        between = np.abs(np.log(about.frequency / mode.natural_frequency)) < 2 * abs(shift)
        resolved = np.count_nonzero(between) >= SETTINGS.alone_fewest
        clear = resolved and float(np.mean((about.shown & about.clear)[between])) >= SETTINGS.alone_clear
        if not clear or abs(damping) >= SETTINGS.as_damped or gain_of_one(moved) < SETTINGS.alone_least:
            return None
        gain = (
            gain_of_one(moved)
            if about.together
            else gain_over_loads(about, moved.rows, mode.natural_frequency, least=SETTINGS.alone_open_from)
        )
        if gain < SETTINGS.alone_open_from:
            return None
        likely = 1.0 if gain >= SETTINGS.alone_decisive else float(expit(gain - SETTINGS.alone_half))
        return OtherShapes("natural frequency", (), moved.rows, gain, moved, likely)

    found = [one for one in side_by_side(found_of, range(len(dynamics.modes))) if one is not None]
    return max(found, key=lambda one: one.gain, default=None)


def one_moved(
    ringing: RingingSpectra,
    record: CoupledRecord,
    parts: Mapping[str, ComponentForce],
    readings: Mapping[str, Observation],
    *,
    first: int,
) -> OtherShapes | None:
    """Return the one mode that has moved, by the reading of the component that shows it most; None where none does.

    Where a load excites one mode alone, all that speaks for its move is in a few bands, where a narrow band of the
    load would be too. Its reading tells them apart: no load makes a hole where the resonance was expected.
    It is believed from the same gain on as of a single component, or left open (`spoken_for`).
    """
    dynamics = record.dynamics
    if not dynamics.has_one_mode_each:
        return None
    last, interval = min(first + most_samples(record), record.recording.samples), record.interval
    found: list[tuple[float, int, Array]] = []
    for name, reading in readings.items():
        known, learned = reading.dynamics, parts[name].learned
        # what a ground channel leaves in the readings swings as well
        left = any(doubt.kind.startswith(("ground", "attitude")) for doubt in parts[name].doubts)
        if left or not reading.present.all():
            continue
        calm = calm_stretch(first, last, steps=parts[name].steps, interval=interval, dynamics=known)
        if calm.stop - calm.start < FEWEST_SAMPLES:
            continue
        values = without_tones(reading.values[calm, None])[:, 0]
        near = near_resonance(values - values.mean(), interval, known)
        if near is None:
            continue
        change = np.log([near.natural_frequency / known.natural_frequency, near.damping_ratio / known.damping_ratio])
        if abs(change[0]) < SETTINGS.as_expected[0] * known.damping_ratio and abs(change[1]) < SETTINGS.as_expected[1]:
            continue
        # what is expected of the component alone may be as broad as the noise: a mode rings as one of the balance
        away = [abs(np.log(near.natural_frequency / mode.natural_frequency)) for mode in dynamics.modes]
        place = int(np.argmin(away))
        if abs(np.log(near.damping_ratio / dynamics.modes[place].damping_ratio)) > SETTINGS.as_damped:
            continue
        evidence = evidence_in(values, interval=interval, least_noise=reading.least_noise, learned=learned)
        evidence = replace(evidence, among=(known, near))
        gain = evidence.of(near) - evidence.of(known) - float(np.log(len(readings)))  # chance has as many tries
        if gain > RESONANCE.open_from and abs(change[1]) < SETTINGS.as_damped:
            apart = [abs(np.log(mode.natural_frequency / known.natural_frequency)) for mode in dynamics.modes]
            found.append((gain, int(np.argmin(apart)), change))
    if not found:
        return None
    gain, place, change = max(found, key=lambda one: one[0])
    own = Moved.none(dynamics)
    moved = closer(partial(evidence_of, ringing), own, place, own.by(place, change))
    gains = evidence_of(ringing, moved) - evidence_of(ringing, own)
    if abs(moved.changes[place, 1]) > SETTINGS.as_damped or float(np.sum(gains)) < RESONANCE.open_from:
        return None
    frequency = dynamics.modes[place].natural_frequency
    about = ringing.near(frequency, within=SETTINGS.alone_about)
    if about is None:
        return None
    least = SETTINGS.alone_open_from
    if gain_over_loads(about, moved.rows, frequency, least=least) < least:
        return None
    likely = float(expit(RESONANCE.open_steepness * (gain - RESONANCE.open_half)))
    return OtherShapes(
        "natural frequency", (), moved.rows, gain, moved, 1.0 if gain >= RESONANCE.decisive_near else likely
    )
