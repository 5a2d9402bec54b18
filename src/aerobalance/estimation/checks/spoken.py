"""What the dynamics are that a record speaks for: another resonance, a further mode, or what a load makes as well."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.special import expit

from aerobalance.dynamics.modal import Mode
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.checks.evidence import Evidence


@dataclass(frozen=True, slots=True)
class ResonanceSettings:
    """What is tried, and from which evidence on it is believed.

    Attributes
    ----------
    decisive
        Gain in log-likelihood, the price of the numbers paid, that other dynamics must bring. Of 576 records that
        agree none left a further mode open.
    worth_a_look
        Gain from which on a resonance near the expected one is looked at closer.
    decisive_near
        Gain that a resonance near the expected one must bring, for which no price is paid.
    open_from, open_half, open_steepness
        Gain of such a resonance from which on the record leaves it open, at which it is as likely as the expected one,
        and how fast that grows. Of 1100 records that agree, of eleven kinds, 11 reached 4, 2 reached 6 and one
        reached 10.
    open_far, open_far_half
        The same of a further mode and of a resonance that is far off, the price of their numbers paid, and of a
        balance that does not ring.
    usual
        Factor by which a damping ratio is usually off, one standard deviation of its logarithm: of a short record a
        resonance of any width may be left, and one ten times as wide is not as likely as one that is nearly the same.
    by_steps
        Gain of the expected dynamics with the steps that were found over other ones, from which on these are not
        believed. A missing mode that is taken for a slower release gives up to 23; a square wave 120 and more.
    many
        Steps more than a period apart from which on a resonance as narrow as a line of their spectrum is one, and no
        resonance.
    confirmed
        Gain of the dynamics over a balance that does not ring, from which it is certain that it rings near there; a
        resonance far from it must gain as much over them, which may explain a part of its ringing.
    far, broad
        Relative change of the natural frequency from which a resonance with more than this damping ratio is taken for
        a narrow band of the load, unless the record speaks against its own resonance: it is left open at most, by what
        it gains with the damping ratio that is known.
    shifts
        Relative changes of the natural frequency that are tried.
    dampings
        Factors of the damping ratio that are tried.
    shares, large_shares
        Shares of a further mode that are tried, and the damping ratio that it is tried with; large ones at the highest
        peak alone, and at the highest that is far from all known modes.
    most_tries
        Dynamics of a kind that are tried at most to come to the best, and once more from there the other way round;
        near that as many more as it is looked closer.
    beyond
        Factor of the natural frequency that puts it beyond all that is looked at.
    line, line_beside, line_damped
        Width in ordinates up to which a moved resonance, a mode beside it, and the known resonance with less damping
        are a tone: the last is what the window makes of one.
    band
        Half widths of a narrow band of the load over the frequency of a peak that it may make: a tone that wanders.
    band_from, band_half, band_decisive
        Gain of other dynamics over the expected ones beside such a load from which on they are possible, at which they
        are as likely as that load, and from which on they are believed. Of 70 records with a tone that wanders, or a
        narrow band, none reached 1.2, but for a band that has the shape of a resonance; of 24 with another natural
        frequency, by 2.5 % and more, the least was 4.4.
    band_alike
        The last of a resonance that the record resolves and whose damping is the known one: such a load has the same
        width by chance alone.
    band_damped, band_mode
        The same of less damping alone, which such a load at the natural frequency looks like, and of a further mode,
        which is named with it: what is left is that a resonance needs a force that shows beside it as well.
    band_at_first
        Gain before the dynamics have come to their best below which all of a record are those of such a load, and are
        not looked at closer. Of 44 stretches with a tone that wanders all were below -6; of 70 records of other
        dynamics one kind of others of one record was below 0, beside kinds that were above.
    band_unresolved, unresolved
        Gain from which on less damping that the record does not resolve is left open, and its probability: a tone of
        the load at just the natural frequency looks the same. Of 64 sound records of six kinds none came to it.
    many_peaks
        Narrow peaks from which on a load repeats, and none of them is a mode as narrow as a tone.
    line_reach
        Ordinates on either side of a tone in which it shows.
    closer
        Size of the second search over that of the first.
    share_shift
        Relative change of a share by which its uncertainty is taken.
    """

    decisive: float = 12.0
    worth_a_look: float = 2.0
    decisive_near: float = 11.0
    open_from: float = 4.5
    open_half: float = 8.0
    open_steepness: float = 0.8
    usual: float = 2.0
    open_far: float = 7.0
    open_far_half: float = 10.0
    by_steps: float = 50.0
    many: int = 5
    confirmed: float = 25.0
    far: float = 0.1
    broad: float = 0.03
    shifts: tuple[float, ...] = (-0.03, -0.01, 0.01, 0.03)
    dampings: tuple[float, ...] = (1 / 2.5, 2.5)
    shares: tuple[tuple[float, float], ...] = ((0.03, 0.008), (-0.03, 0.008))
    large_shares: tuple[tuple[float, float], ...] = ((0.1, 0.012), (-0.1, 0.012))
    most_tries: int = 20
    beyond: float = 1e3
    line: float = 0.3
    line_beside: float = 2.0
    line_damped: float = 1.44
    band: tuple[float, ...] = (0.06, 0.1)
    band_from: float = 0.5
    band_half: float = 1.5
    band_decisive: float = 3.0
    band_alike: float = 2.0
    band_damped: float = -3.0
    band_mode: float = -5.0
    band_at_first: float = -5.0
    band_unresolved: float = -1.0
    unresolved: float = 0.5
    many_peaks: int = 8
    line_reach: float = 3.0
    closer: float = 0.3
    share_shift: float = 0.3


SETTINGS: Final = ResonanceSettings()
"""Settings that are used."""

OF_LOAD: Final = 0.05
"""Relative distance of two frequencies within which both are those of the same narrow load."""

SAME_DAMPING: Final = 1e-6
"""Relative difference of two damping ratios that is rounding."""

MOVED: Final = ("natural frequency", "damping ratio")
"""Kinds of dynamics with as many modes as are known: the same free oscillation tells against either."""


class Spoken(NamedTuple):
    """The dynamics that a record speaks for, and how clearly.

    Attributes
    ----------
    kind
        ``"natural frequency"``, ``"damping ratio"``, ``"missing mode"`` or ``"no resonance"``.
    dynamics
        The dynamics.
    gain
        Gain in log-likelihood over those that the record was read with.
    u
        Relative standard uncertainty of the frequency that is other [1].
    u_share
        Relative standard uncertainty of the share of a further mode [1].
    probability
        Probability of them [1]; 0 where a load in narrow bands explains far better what they gain.
    """

    kind: str
    dynamics: Dynamics
    gain: float
    u: float = 0.0
    u_share: float = 0.0
    probability: float = 1.0

    @property
    def mode(self) -> Mode:
        """The mode by which they are other."""
        return self.dynamics.modes[-1] if self.kind == "missing mode" else self.dynamics.modes[0]


def named(spoken: Spoken, evidence: Evidence, dynamics: Dynamics, *, confirmed: float) -> Spoken | None:
    """The same with the kind by what has come out, and with its uncertainty; None for what a load makes as well."""
    kind, other = spoken.kind, spoken.dynamics
    if kind == "no resonance":
        likely = _over_narrow_loads(spoken, evidence, dynamics)
        return spoken._replace(probability=likely * spoken.probability) if likely > 0 else None
    if kind == "missing mode":
        mode = other.further_modes[-1]
        if is_line(mode, evidence, width=SETTINGS.line_beside) and not (
            _beside_its_line(spoken, evidence, dynamics) or _likelier_than_narrow_loads(spoken, evidence, dynamics)
        ):
            return None

        def at(factor: float, share: float = 1.0) -> Dynamics:
            moved = Mode(mode.natural_frequency * factor, mode.damping_ratio, mode.share * share)
            return dynamics.with_modes(*dynamics.further_modes, moved)

        spoken = spoken._replace(u_share=_spread(evidence, lambda by: at(1.0, by), shift=SETTINGS.share_shift))
        width = mode.damping_ratio
    else:
        found = _moved(spoken, evidence, dynamics, confirmed=confirmed)
        if found is None:
            return None
        spoken, other = found, found.dynamics
        width = max(dynamics.damping_ratio, spoken.dynamics.damping_ratio)

        def at(factor: float, share: float = 1.0) -> Dynamics:
            return other.retuned(frequency=factor, damping=1.0)

    likely = _over_narrow_loads(spoken, evidence, dynamics)
    if likely == 0:
        return None
    return spoken._replace(u=_spread(evidence, at, shift=0.5 * width), probability=likely * spoken.probability)


def _moved(spoken: Spoken, evidence: Evidence, dynamics: Dynamics, *, confirmed: float) -> Spoken | None:
    """A resonance that has moved with the kind by what has come out; None for what a load makes as well."""
    other = spoken.dynamics
    factor = other.natural_frequency / dynamics.natural_frequency
    moved, width = abs(factor - 1), max(dynamics.damping_ratio, other.damping_ratio)
    kind = "natural frequency" if moved > 0.5 * width else "damping ratio"
    same = dynamics.retuned(frequency=factor, damping=1.0)
    if kind == "natural frequency" and evidence.of(other) - evidence.of(same) < price_of("damping ratio", evidence):
        other = same  # another damping ratio as well only where it is worth what that costs
    if is_line(other.modes[0], evidence, width=SETTINGS.line):
        return None
    spoken = spoken._replace(kind=kind, dynamics=other)
    if moved <= SETTINGS.far:
        return spoken
    if confirmed > SETTINGS.confirmed > spoken.gain:
        return None
    if other.damping_ratio <= SETTINGS.broad or confirmed <= -SETTINGS.decisive:
        return spoken
    # a broad peak may be the load's: what is left of it is what it gains with the damping ratio that is known
    gain = evidence.of(same) - evidence.of(dynamics) - price_of(kind, evidence)
    if same.damping_ratio > SETTINGS.broad or gain < SETTINGS.open_far:
        return None
    return open_far(spoken._replace(dynamics=same, gain=gain))


def open_far(spoken: Spoken) -> Spoken:
    """The same, far from the expected dynamics, with its probability by its gain, which is not decisive."""
    likely = float(expit(SETTINGS.open_steepness * (spoken.gain - SETTINGS.open_far_half)))
    return spoken._replace(probability=likely)


def _over_narrow_loads(spoken: Spoken, evidence: Evidence, dynamics: Dynamics) -> float:
    """Probability of other dynamics where the load may have narrow bands, as the tone of a vortex that wanders [1].

    A resonance shows beside its peak as well, on both sides, and where the expected one is missing; such a load shows
    in its band alone, to which it adds.
    """
    kind, mode, other = spoken.kind, spoken.mode, spoken.dynamics
    alike = abs(other.damping_ratio / dynamics.damping_ratio - 1) < SAME_DAMPING if dynamics.damping_ratio else False
    decisive, least = SETTINGS.band_decisive, SETTINGS.band_from
    if kind == "missing mode":
        decisive = least = SETTINGS.band_mode
    elif kind == "natural frequency" and alike and not is_line(mode, evidence, width=SETTINGS.line_beside):
        decisive = SETTINGS.band_alike
    damped = kind == "damping ratio" and mode.damping_ratio < dynamics.damping_ratio
    unresolved = damped and is_line(mode, evidence, width=SETTINGS.line_damped)
    if damped:
        least = SETTINGS.band_unresolved if unresolved else SETTINGS.band_damped
    gain = gain_over_narrow_loads(spoken, evidence, dynamics, enough=least)
    if gain >= decisive:
        return 1.0
    if damped:
        return float(gain > least) * (SETTINGS.unresolved if unresolved else 1.0)
    if gain < least:
        return 0.0
    return float(expit(SETTINGS.open_steepness * (gain - SETTINGS.band_half)))


def gain_over_narrow_loads(spoken: Spoken, evidence: Evidence, dynamics: Dynamics, *, enough: float) -> float:
    """Gain in log-likelihood of other dynamics where the load may have narrow bands about what they tell, at least.

    Below `enough` it does not matter how low it is.
    """
    bands: list[tuple[float, float] | None] = [None]
    if spoken.kind != "no resonance":
        centre = spoken.mode.natural_frequency
        bands = [(centre * (1 - half), centre * (1 + half)) for half in SETTINGS.band]
    return evidence.over_narrow_loads(spoken.dynamics, dynamics, bands, enough=enough)


def _spread(evidence: Evidence, at: Callable[[float], Dynamics], *, shift: float) -> float:
    """Relative standard uncertainty of a number, by how fast the evidence falls when it is off by a factor."""
    bend = 2 * evidence.of(at(1.0)) - evidence.of(at(1 + shift)) - evidence.of(at(1 - shift))
    return shift / float(np.sqrt(max(bend, 0.25)))


def is_line(mode: Mode, evidence: Evidence, *, width: float) -> bool:
    """Whether a mode is narrower than so many ordinates: a tone of the load, whose size changes a little."""
    return 2 * mode.damping_ratio * mode.natural_frequency * evidence.values.size * evidence.interval < width


def _beside_its_line(spoken: Spoken, evidence: Evidence, dynamics: Dynamics) -> bool:
    """Whether a further mode as narrow as a tone is believed by what a tone does not show: the skirts of a resonance.

    Chance may leave a mode of a short record no wider than a tone, but a tone has no antiresonance beside it. Where a
    load ends just above the mode its skirts are told by the band that a narrow load may have (`named`).
    """
    centre = spoken.dynamics.further_modes[-1].natural_frequency
    reach = SETTINGS.line_reach / (evidence.values.size * evidence.interval)
    line = centre - reach, centre + reach
    gain = evidence.beside(spoken.dynamics, line) - evidence.beside(dynamics, line)
    return gain - price_of(spoken.kind, evidence) >= SETTINGS.decisive


def _likelier_than_narrow_loads(spoken: Spoken, evidence: Evidence, dynamics: Dynamics) -> bool:
    """Whether a further mode as narrow as a tone is likelier than a load in narrow bands, which has a few of them.

    Of the many harmonics of a load that repeats one or the other has skirts by chance.
    """
    if evidence.narrow_peaks(dynamics) >= SETTINGS.many_peaks:
        return False
    return gain_over_narrow_loads(spoken, evidence, dynamics, enough=SETTINGS.band_half) >= SETTINGS.band_half


def price_of(kind: str, evidence: Evidence) -> float:
    """Schwarz's price of the numbers that dynamics have more than those known."""
    numbers = {"no resonance": 0, "natural frequency": 2, "damping ratio": 1, "missing mode": 3}[kind]
    return 0.5 * numbers * float(np.log(evidence.values.size / 2))
