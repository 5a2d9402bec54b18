"""Terms of a balance matrix: the kinds of AIAA R-091, the models made of them, and their names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.recording.channel import Array

Model = Literal["linear", "quadratic", "abs", "27", "96", "auto"]

SHAPES: Final = ("{a}", "|{a}|", "{a}*{a}", "{a}*|{a}|", "{a}*{b}", "|{a}*{b}|", "{a}*|{b}|", "|{a}|*{b}")
SHAPES_CUBIC: Final = ("{a}*{a}*{a}", "|{a}*{a}*{a}|")
KINDS: Final = (*SHAPES, *SHAPES_CUBIC)
"""Kinds of terms in the order of AIAA R-091: F, |F|, F^2, F|F|, FG, |FG|, F|G|, |F|G, F^3, |F^3|."""

MODELS: Final[Mapping[str, tuple[int, ...]]] = {
    "linear": (0,),
    "abs": (0, 1),
    "quadratic": (0, 2, 4),
    "27": (0, 2, 4),
    "96": tuple(range(10)),
    "auto": tuple(range(10)),
}
"""Kinds of terms of each model; Eq. (2) of the paper and the 6x27 model of AIAA R-091 have the same terms."""

PAIRS: Final = (4, 5, 6, 7)
"""Kinds made of two different variables."""


class Term(NamedTuple):
    """One term of the polynomials: a kind (index into `KINDS`) and its variables (the same one twice if one)."""

    kind: int
    first: int
    second: int

    def label(self, names: tuple[str, ...]) -> str:
        """Write the term with the names of its variables."""
        return KINDS[self.kind].format(a=names[self.first], b=names[self.second])


def terms_of(model: str, count: int) -> tuple[Term, ...]:
    """Return all terms of a model for `count` variables, in the order of AIAA R-091."""
    if model not in MODELS:
        raise ValueError(f"model must be one of {', '.join(MODELS)}, not {model!r}")
    terms: list[Term] = []
    for kind in MODELS[model]:
        if kind in PAIRS:
            terms += [Term(kind, i, j) for i in range(count) for j in range(i + 1, count)]
        else:
            terms += [Term(kind, i, i) for i in range(count)]
    return tuple(terms)


def codes(terms: tuple[Term, ...]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Terms as the integer arrays that the kernels take."""
    table = np.array(terms, dtype=np.int64).reshape(-1, 3)
    first, second, third = (np.ascontiguousarray(table[:, k]) for k in range(3))
    return first, second, third


def by_label(names: tuple[str, ...]) -> dict[str, Term]:
    """All terms of variables with these names, by what `Term.label` writes for them."""
    return {term.label(names): term for term in terms_of("96", len(names))}


def linear_part(terms: tuple[Term, ...], coefficients: Array) -> Array:
    """Coefficients of the linear terms, results in rows, variables in columns, shape (c, c), of all, shape (t, c)."""
    matrix = np.zeros((coefficients.shape[1], coefficients.shape[1]))
    for term, row in zip(terms, coefficients, strict=True):
        if term.kind == 0:
            matrix[:, term.first] = row
    return matrix
