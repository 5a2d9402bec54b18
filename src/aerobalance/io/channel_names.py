"""What the column of a foreign file may be, told from its name and its unit."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from aerobalance.io.columns import Heading
from aerobalance.recording.channel import QUANTITIES, unit_inside
from aerobalance.recording.components import COMPONENTS, is_gauge
from aerobalance.recording.units import ALLOWED, conversion, conversion_for

_LOADS: Final[Mapping[str, tuple[str, ...]]] = {
    "AF": ("axialkraft", "kraft axial", "axial force", "force axiale", "fuerza axial", "forza assiale", "axial"),
    "NF": ("normalkraft", "normal force", "force normale", "fuerza normal", "forza normale", "normal"),
    "SF": ("seitenkraft", "querkraft", "side force", "force laterale", "fuerza lateral", "forza laterale", "side"),
    "PM": ("nickmoment", "pitching moment", "pitch moment", "moment de tangage", "momento de cabeceo"),
    "YM": ("giermoment", "yawing moment", "yaw moment", "moment de lacet", "momento de guinada"),
    "RM": ("rollmoment", "rolling moment", "roll moment", "moment de roulis", "momento de balanceo"),
}
_OTHERS: Final[Mapping[str, tuple[str, ...]]] = {
    "pitch": ("pitch", "nickwinkel", "pitch angle", "angle de tangage", "assiette", "angulo de cabeceo"),
    "roll": ("roll", "rollwinkel", "roll angle", "angle de roulis", "angulo de balanceo"),
    "excitation": (
        *(
            "speisespannung",
            "bruckenspeisung",
            "excitation voltage",
            "bridge excitation",
            "supply voltage",
            "excitation",
        ),
        *("alimentation", "tension d'alimentation", "u_exc", "uexc"),
    ),
    "temperature": ("temperatur", "temperature", "temp", "temperatura", "balance temperature", "waagentemperatur"),
}
_SURE: Final = {word: name for table in (_LOADS, _OTHERS) for name, words in table.items() for word in words}

_PERHAPS: Final = (
    (r"f_?x", "AF (positive aft; Fx often is positive forward)"),
    (r"f_?y", "SF (positive right)"),
    (r"f_?z", "NF (positive up; Fz often is positive down)"),
    (r"m_?x", "RM"),
    (r"m_?y", "PM"),
    (r"m_?z", "YM"),
    (r"(alpha|α|aoa|anstellwinkel|angle of attack|incidence|angle d.attaque)\b.*", "pitch, where the flow is level"),
    (r"(phi|φ)\b.*", "roll"),
)
_BY_UNIT: Final[Mapping[str, str]] = {
    "mV/V": "a gauge output: r and the component of its bridge, as rAF or rN1",
    "N": f"a load: {', '.join(name for name in COMPONENTS if unit_inside(name) == 'N')}",
    "N*m": f"a load: {', '.join(name for name in COMPONENTS if unit_inside(name) == 'N*m')}",
    "m/s^2": "an acceleration: ground_acceleration (aft), ground_acceleration_y (right), _z (up); live_acceleration",
    "rad/s^2": "an angular acceleration: ground_turn_PM, _YM or _RM",
    "rad": "an angle: pitch or roll",
    "V": "excitation, or a gauge output beside it: rAF, rN1",
    "degC": "temperature",
}


@dataclass(frozen=True, slots=True)
class Proposal:
    """What a column may be.

    Attributes
    ----------
    name
        The channel that it is without doubt; an empty string where a person has to say it.
    hint
        What it may be otherwise; an empty string where nothing tells.
    """

    name: str = ""
    hint: str = ""


def proposals(headings: Sequence[Heading]) -> list[Proposal]:
    """Propose for every column what it is: a channel where name and unit leave no doubt, else what may help."""
    found = [_proposal(heading) for heading in headings]
    counted = Counter(one.name for one in found if one.name)
    excited = counted["excitation"] == 1
    settled = []
    for heading, one in zip(headings, found, strict=True):
        if counted[one.name] > 1:
            settled.append(Proposal("", f"{one.name}, as other columns may be"))
        elif is_gauge(one.name) and heading.unit and _quantity(heading.unit) == "V" and not excited:
            settled.append(Proposal("", f"{one.name}, with excitation = ... in V: the unit is a voltage"))
        else:
            settled.append(one)
    return settled


def _proposal(heading: Heading) -> Proposal:
    name, unit = heading.name.rsplit("/", 1)[-1].strip(), heading.unit
    quantity = _quantity(unit) if unit else None
    if heading.name in QUANTITIES or is_gauge(heading.name):
        return _exact(heading.name, unit, quantity)
    sure = _SURE.get(_plain(name), "")
    if quantity == "mV/V" and (sure in COMPONENTS or _OF_BALANCE.fullmatch(name)):
        return Proposal(f"r{sure or name}")
    if sure:
        return Proposal(sure) if unit and _fits(sure, unit) else Proposal("", sure)
    for pattern, hint in _PERHAPS:
        if re.fullmatch(pattern, name, re.IGNORECASE):
            return Proposal("", hint)
    return Proposal("", _BY_UNIT.get(quantity or "", ""))


def _exact(name: str, unit: str, quantity: str | None) -> Proposal:
    """Propose for a column that has the name of a channel."""
    if not unit or _fits(name, unit):
        return Proposal(name)
    if quantity in ("mV/V", "V") and name in COMPONENTS:
        return Proposal(f"r{name}")
    return Proposal("", f"{name}, but the unit is that of something else")


_OF_BALANCE: Final = re.compile(r"(N|S|Y|A|R|P|NF|AF|SF|PM|YM|RM|Ax|Axial|Roll)[1-4]?")
"""Names that balances give their components, in use for their bridges too."""


def _plain(name: str) -> str:
    """A name in small letters without accents; signs between words are one space."""
    letters = unicodedata.normalize("NFKD", name.casefold())
    bare = "".join(sign for sign in letters if not unicodedata.combining(sign))
    return re.sub(r"[\s_.-]+", " ", bare).strip() if bare not in _SURE else bare


def _fits(name: str, unit: str) -> bool:
    try:
        conversion_for(name, unit)
    except ValueError:
        return False
    return True


def _quantity(unit: str) -> str | None:
    """The unit inside that a unit belongs to, a key of `ALLOWED`; None where it is unknown or belongs to none."""
    for expected in ALLOWED:
        try:
            conversion(unit, expected=expected)
        except ValueError:
            continue
        return expected
    return None
