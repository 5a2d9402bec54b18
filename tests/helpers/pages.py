"""What the pages of the documentation show to be typed: commands and Python."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
PAGES = sorted(ROOT.glob("docs/**/*.md"))


def fenced(text: str) -> Iterator[tuple[str, str]]:
    """Language and content of every fenced block, also of those in lists and in other blocks."""
    for found in re.finditer(r"^( *)(`{3,})([\w{}-]*)\n(.*?)^\1\2$", text, re.MULTILINE | re.DOTALL):
        yield found[3], "\n".join(line.removeprefix(found[1]) for line in found[4].splitlines())


def commands(text: str, language: str | None = None) -> list[str]:
    """Lines that begin with the program's name in code, without their remarks; of blocks of one language if given."""
    blocks = [body for kind, body in fenced(text) if language in (None, kind)]
    if language is None:
        blocks += re.findall(r"^    (aerobalance .*(?:\\\n.*)*)$", text, re.MULTILINE)
    lines = [line for body in blocks for line in re.sub(r"\s*\\\n\s*", " ", body).splitlines()]
    found = [line.split("  #")[0].strip() for line in lines]
    return [line for line in found if line.startswith("aerobalance ")]


def python(text: str) -> list[str]:
    """The Python blocks of a page."""
    return [body for kind, body in fenced(text) if kind == "python"]
