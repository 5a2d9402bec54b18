"""What laboratories call the columns of a load schedule, in English, German and French."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

MARKS: Final = ("series", "point", "confirmation", "natural_zero", "temperature", "excitation")
"""Columns that a schedule may have beside loads and outputs, as channel maps name them."""

_WORDS: Final[Mapping[str, Sequence[str]]] = {
    "series": (
        *("series", "load series", "series no", "series name", "run", "sequence"),
        *("serie", "reihe", "lastreihe", "messreihe", "belastungsreihe", "belastungsserie", "lastserie", "seriennr"),
        *("série", "série de charge", "séquence", "série n°"),
    ),
    "point": (
        *(
            "point",
            "points",
            "point no",
            "point number",
            "pt",
            "load point",
            "step",
            "load step",
            "no",
            "nr",
            "n°",
            "#",
        ),
        *("punkt", "messpunkt", "lastpunkt", "punktnr", "punkt-nr", "stufe", "laststufe", "lfd nr", "nummer"),
        *("point de mesure", "point de charge", "point n°", "palier", "numéro"),
    ),
    "confirmation": (
        *("confirmation", "confirmation point", "check point"),
        *("bestätigung", "bestätigungspunkt", "kontrollpunkt", "prüfpunkt"),
        *("point de contrôle", "point de vérification"),
    ),
    "natural_zero": (
        *("natural zero", "natural zeros", "natural_zero"),
        *("natürlicher nullpunkt", "natürliche null"),
        *("zéro naturel", "zéros naturels"),
    ),
    "temperature": ("temperature", "temp", "temperatur", "température"),
    "excitation": (
        *("excitation", "excitation voltage", "bridge supply", "supply voltage"),
        *("speisespannung", "speisung", "brückenspeisung", "brückenspannung", "versorgungsspannung"),
        *("alimentation", "tension d'alimentation"),
    ),
}

_OUTPUTS: Final = (
    *("output", "signal", "bridge", "gauge", "gage", "reading"),
    *("ausgang", "brücke", "dms", "messwert"),
    *("sortie", "pont", "jauge"),
)
"""Words that say, before or after the name of a load, that a column is the output of its bridge."""

TRUE: Final = ("1", "x", "yes", "y", "true", "ja", "j", "wahr", "oui", "o", "vrai")
"""Cells, in small letters, that mark a row."""

FALSE: Final = ("0", "", "-", "no", "n", "false", "nein", "falsch", "non", "faux")
"""Cells, in small letters, that do not."""


def column_key(name: str) -> str:
    """Return what spellings of a column's name have in common: small letters and digits alone."""
    plain = name.casefold().replace("n°", "nr").replace("nº", "nr").replace("#", "nr")
    return "".join(sign for sign in plain if sign.isalnum())


_MARK_OF: Final = {column_key(word): mark for mark, words in _WORDS.items() for word in words}
_OUTPUT_KEYS: Final = tuple(column_key(word) for word in _OUTPUTS)


def mark_of(name: str) -> str | None:
    """Return which of `MARKS` a column's name stands for; None where it is none of them."""
    return _MARK_OF.get(column_key(name))


def is_output_of(name: str, load: str) -> bool:
    """Return whether a column's name is that of the output of a load's bridge, such as rN1, "R N1" or "Bridge N1"."""
    key, of = column_key(name), column_key(load)
    if not of:
        return False
    return key == f"r{of}" or any(key in (f"{word}{of}", f"{of}{word}") for word in _OUTPUT_KEYS)
