"""The page of benchmarks: it can be read, and the command that writes it gives what it has."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"


def read(text: str) -> list[dict[str, str]]:
    """Rows of all tables of a page by the heads of their columns."""
    rows, heads = [], None
    for line in text.splitlines():
        if not line.startswith("|"):
            heads = None
            continue
        cells = [cell.strip() for cell in line.strip("|").replace("\\|", "\0").split("|")]
        if heads is None:
            heads = cells
        elif set(cells) != {"---"}:
            assert len(cells) == len(heads), line
            rows.append(dict(zip(heads, cells, strict=True)))
    return rows


def written(here: Path, rows: list[dict[str, object]], *options: str) -> list[dict[str, str]]:
    (here / "rows.json").write_text(json.dumps(rows))
    command = [sys.executable, DOCS / "benchmarks.py", "--rows", here / "rows.json", "--page", here / "page.md"]
    subprocess.run([*command, *options], check=True)
    return read((here / "page.md").read_text(encoding="utf-8"))


def test_the_page_can_be_read() -> None:
    rows = read((DOCS / "benchmarks.md").read_text(encoding="utf-8"))
    assert rows
    assert len({row["what"] for row in rows}) == len(rows)
    for row in rows:
        ratio, target = float(row["ratio"]), float(row["target"])
        if abs(ratio - target) > 0.01 * target:  # both are written with three digits
            assert row["holds"] == ("" if target == 0 else "yes" if ratio > target else "**no**"), row


@pytest.mark.parametrize("earlier", [False, True])
def test_the_command_writes_every_row(tmp_path: Path, earlier: bool) -> None:
    rows = [
        {"name": "time of a | over b", "ratio": 2.345678, "target": 2.0, "subject": "Speed."},
        {"name": "bound over error", "ratio": 0.9, "target": 0.95, "subject": "Accuracy."},
        {"name": "to be read", "ratio": 12.0, "target": 0.0, "subject": "Speed."},
    ]
    options = []
    if earlier:
        (tmp_path / "earlier.json").write_text(
            json.dumps({"commit": "abc", "date": "today", "rows": [{"name": "bound over error", "ratio": 0.8}]})
        )
        options = ["--before", str(tmp_path / "earlier.json")]
    found = written(tmp_path, rows, *options)
    assert [row["what"].replace("\0", "|") for row in found] == [
        "bound over error",
        "time of a | over b",
        "to be read",
    ]
    assert [row["ratio"] for row in found] == ["0.9", "2.35", "12"]
    assert [row["holds"] for row in found] == ["**no**", "yes", ""]
    if earlier:
        assert [row.get("on today") for row in found] == ["0.8", None, None]
