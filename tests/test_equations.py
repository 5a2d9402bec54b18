"""Every equation of the paper has one home, which cites it; docs/equations.md says where."""

import inspect
import re
from pathlib import Path

import pytest

from helpers.full_names import at

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/equations.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| \((\d+)\) \| .* \| `([\w.]+)` \|$", PAGE, re.MULTILINE)
STEPS = {4, 5, 9, 10}  # of the paper's derivation, which (8), (11) and (12) end
CITED = re.compile(r"Eqs?\. \((\d+)\)(?: (to|and) \((\d+)\))?")


def cited(text):
    """Collect the numbers of the equations that a text names."""
    found = set()
    for first, how, last in CITED.findall(text):
        found |= set(range(int(first), int(last) + 1)) if how == "to" else {int(first), int(last or first)}
    return found


def test_every_equation_has_one_home() -> None:
    assert sorted(int(number) for number, _ in ROWS) == sorted(set(range(1, 21)) - STEPS)


@pytest.mark.parametrize(("number", "home"), ROWS)
def test_home_cites_its_equation(number, home) -> None:
    text = " ".join((inspect.getdoc(at(home)) or "").split())
    assert int(number) in cited(text), text
    assert "[Gorbushin2020]_" in text


def test_no_other_equation_is_cited() -> None:
    for path in (ROOT / "src").rglob("*.py"):
        assert cited(path.read_text(encoding="utf-8")) <= {int(number) for number, _ in ROWS}, path
