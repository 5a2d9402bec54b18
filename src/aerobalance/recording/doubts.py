"""Doubts: what a record says against its result, what that does to the force, and what to do next."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

from aerobalance.recording.wording import last_number, without_numbers

KINDS: Final[Mapping[str, str]] = {
    "natural frequency": "the balance rings at another natural frequency than that of the dynamics",
    "damping ratio": "the balance rings with another damping ratio than that of the dynamics",
    "missing mode": "the balance rings in a mode that the dynamics lack",
    "not linear": "friction, or damping or stiffness that changes with the motion, which linear dynamics lack",
    "swapped sign": "a component has another sign than in the modes of the dynamics",
    "swapped channels": "two components are exchanged against the modes of the dynamics",
    "ground delay": "a sensor of the ground's motion is late or early against the load",
    "ground clock": "the delay of a sensor of the ground's motion against the load drifts along the record",
    "ground gain": "the load shows another size of the ground's motion than its sensor",
    "attitude delay": "the inclinometer is late or early against the load",
    "attitude gain": "the load shows another size of the weight's change than the inclinometer",
    "units": (
        "loads are far larger than those that the dynamics were identified with, or than the weight lets them be, or "
        "all bridges read next to nothing"
    ),
    "attitude range": "an angle is larger than pitch and roll can be",
    "turning": "the ground turns faster than the angles show",
    "wild samples": "single samples are far from their neighbours",
    "stuck channel": "a channel repeats the same reading, for some time or all along",
    "no readings": "a load is not read up to an end of the record, so that its force is not known there",
    "clipping": "readings rest on a limit",
    "zero": "the bridges moved by more than they drift: while a zero was read, between two, or since the calibration",
    "noise level": "the noise of the readings is not that of the record of noise, or that its channel states",
    "colored noise": "the noise of the readings may not be white",
    "interference": "narrow power above the natural frequency may be of the electronics, and no force",
    "hum": "a line at a frequency of the mains is taken for force, and may be hum",
    "filter gain": "the filter of a load takes off a part of the force that is not made up for",
    "faint force": "the noise hides a force that is taken for constant",
    "resolution": "the readings have few steps, and too little noise to blur them",
    "too many steps": "there are more steps than are looked for",
    "joint": "the forces by two parts of a record differ where they meet",
    "driving force": "a force acts on the balance while it rings down",
    "amplitude dependence": "damping or frequency change with the amplitude of the ringing",
    "close modes": "two modes lie so close to each other that their ringing beats",
    "damping hardly told": "the record tells the damping to no better than a tenth",
    "record cut": "a part of the record does not go with the ringing and is left out",
    "moving ground": "the ground end moves while the balance rings down",
    "double hit": "the hammer touched the model twice in one blow",
    "no pretrigger": "a tap has no readings before it, so that its force cannot be used",
    "clipped force": "the force of a tap rests on a limit, or is not read",
    "force droop": "the channel of a measured force passes no slow changes",
    "force gain": "the balance shows another size of a measured force than its channel",
    "force sign": "a measured force has another sign than the balance shows",
    "force delay": "a measured force is late or early against the loads",
    "tap point": "the model was not tapped at the point or in the direction stated",
    "tap apart": "the force of one tap does not go with the ringing after it",
    "outlying point": "one point of a weighing does not go with the others",
    "mass": "weighing finds another mass than scales",
    "hysteresis": "the loads of a weighing depend on the way its points were reached",
    "unexplained": "the readings depart from what the model of balance and load expects",
}
"""Kinds of doubt, and what each says."""


@dataclass(frozen=True, slots=True)
class Doubt:
    """One thing that a record says against the force worked out of it.

    Attributes
    ----------
    kind
        What it is, from `KINDS`.
    component
        Component whose force is meant.
    text
        What was seen, and what it does to the force.
    advice
        What to do next; may be empty.
    effect
        Root mean square of the error that the force may have from it [unit]; 0 where the force and its uncertainty
        have been mended, None where it is not known.
    unit
        Unit of the effect.
    probability
        How probable it is [1]: below one the record leaves it open, and its error counts by it.
    """

    kind: str
    component: str
    text: str
    advice: str = ""
    effect: float | None = None
    unit: str = "N"
    probability: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"kind must be one of {', '.join(KINDS)}, not {self.kind!r}")

    def __str__(self) -> str:
        return f"{self.text}; {self.advice}" if self.advice else self.text


@dataclass(frozen=True, slots=True)
class Assumption:
    """One thing that is taken for granted because the record cannot show it, and that is not in the uncertainty.

    Attributes
    ----------
    kind
        What it is: ``"load filter"``, ``"gain"``, ``"zero"``, ``"zero drift"``, ``"pitch zero"``, ``"roll zero"``,
        ``"mass"``, ``"cross-axis"``, ``"natural frequency"``, ``"colored noise"``, ``"hum"`` or ``"interference"``.
    component
        Component whose force is meant.
    text
        What is assumed, and what a usual departure from it would do to the force.
    effect
        Root mean square of that change of the force [unit].
    unit
        Unit of the effect.
    """

    kind: str
    component: str
    text: str
    effect: float
    unit: str = "N"

    def __str__(self) -> str:
        return self.text


class Verdict(StrEnum):
    """Whether a force may be used."""

    FIT = "fit for use"
    DOUBTFUL = "doubtful"
    NOT_USABLE = "not usable"


@dataclass(frozen=True, slots=True)
class VerdictSettings:
    """From which effect on a doubt decides.

    Attributes
    ----------
    doubtful
        Effect of a doubt over the stated uncertainty (both rms) from which the force is doubtful: a half makes the
        uncertainty a tenth too small where it is not counted.
    not_usable
        Effect over the fluctuation of the force (both rms) from which it is not usable.
    """

    doubtful: float = 0.5
    not_usable: float = 0.5


DOUBTED: Final = "doubt: "
"""How the name of a contribution begins that is from a doubt."""

SETTINGS: Final = VerdictSettings()
"""Limits that are used."""


@dataclass(frozen=True, slots=True)
class Size:
    """How large a force is.

    Attributes
    ----------
    uncertainty
        Root mean square of its standard uncertainty [N].
    fluctuation
        Root mean square about its mean [N].
    mean
        Its mean [N].
    """

    uncertainty: float
    fluctuation: float
    mean: float


def verdict_of(doubts: Iterable[Doubt], sizes: Mapping[str, Size]) -> Verdict:
    """Return whether forces may be used, by what is doubted and how large the forces are.

    Parameters
    ----------
    doubts
        The doubts of all components.
    sizes
        How large the force of each component is.
    """
    worst = Verdict.FIT
    for doubt in doubts:
        size = sizes[doubt.component]
        if doubt.effect is None:
            worst = Verdict.DOUBTFUL
            continue
        whole = max(size.fluctuation, abs(size.mean))
        if doubt.effect >= SETTINGS.not_usable * whole > 0 and doubt.effect > SETTINGS.doubtful * size.uncertainty:
            return Verdict.NOT_USABLE
        if doubt.effect > SETTINGS.doubtful * size.uncertainty:
            worst = Verdict.DOUBTFUL
    return worst


def of_pieces(doubts: Iterable[Doubt]) -> tuple[Doubt, ...]:
    """Return doubts about pieces of samples as doubts about all of them: one of those that differ in numbers alone.

    It is the one with the largest effect, or the largest last number, which tells how large a thing is.
    """
    groups: dict[tuple[str, str, str], list[Doubt]] = {}
    for doubt in doubts:
        groups.setdefault((doubt.kind, doubt.component, without_numbers(doubt.text)), []).append(doubt)
    merged = []
    for group in groups.values():
        worst = max(group, key=lambda one: (one.effect or 0.0, last_number(one.text)))
        merged.append(replace(worst, effect=None) if any(one.effect is None for one in group) else worst)
    return tuple(merged)


MANY_PARTS: Final = 10
"""Parts from which on chance leaves something open in one of them often enough: of a hundred sound ones one has."""

BY_CHANCE: Final = 0.02
"""Share of parts which, with one more, may leave something open by chance: of 58 three or more do once in a hundred
records."""


def of_all_parts(doubts: Iterable[tuple[Doubt, str]], *, parts: int) -> tuple[Doubt, ...]:
    """Return doubts about parts of a record as doubts about all of it: one of a kind and component, the largest.

    What a few of many parts leave open is none: it counts in the uncertainty there, and chance does the same.

    Parameters
    ----------
    doubts
        Each doubt with words for its part, such as "in part 2 of 8 (10 s to 20 s)".
    parts
        Parts of the record.
    """
    groups: dict[tuple[str, str], list[tuple[Doubt, str]]] = {}
    doubts = list(doubts)
    left_open: dict[str, set[str]] = {}
    for doubt, where in doubts:
        left_open.setdefault(doubt.kind, set()).add(where)
    for doubt, where in doubts:
        few = len(left_open[doubt.kind]) <= 1 + BY_CHANCE * parts
        if parts < MANY_PARTS or doubt.probability == 1 or not few:
            groups.setdefault((doubt.kind, doubt.component), []).append((doubt, where))
    merged = []
    for group in groups.values():
        known = [one for one in group if one[0].effect is not None]
        worst, where = max(known, key=lambda one: one[0].effect or 0.0) if known else group[0]
        further = len({words for _, words in group}) - 1
        like = f" (and the like in {further} further part{'s' if further > 1 else ''})" if further else ""
        text = worst.text if parts == 1 else f"{where}: {worst.text}{like}"
        effect = None if len(known) < len(group) else worst.effect
        merged.append(replace(worst, text=text, effect=effect))
    return tuple(merged)
