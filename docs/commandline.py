"""The commands with their arguments and options, as the program itself has them: the directive ``commands``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer
from docutils import nodes
from sphinx.util.docutils import SphinxDirective

from aerobalance.app.cli.program import app

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sphinx.application import Sphinx

LAST = ("--json", "--verbose", "--replace")
"""Options that all commands have, which stand once above."""


def leaves(command: Any, words: str) -> Iterator[tuple[str, Any]]:
    """Every command with the words that call it."""
    inner = getattr(command, "commands", None)
    if inner is None:
        yield words, command
        return
    for name, one in inner.items():
        yield from leaves(one, f"{words} {name}")


def text_of(words: str, command: Any) -> str:
    """Heading, purpose, example and table of one command, in Markdown."""
    lines = [f"## {words.split(maxsplit=1)[1]}", "", command.help, ""]
    lines += ["```sh", command.epilog.removeprefix("Example: "), "```", "", "| | |", "|---|---|"]
    for one in command.params:
        told = (getattr(one, "help", None) or "").replace("|", "\\|")
        if one.param_type_name == "argument":
            lines.append(f"| `{one.metavar or one.name}` | {told} |")
        elif not set(LAST) & set(one.opts):
            names = ", ".join(f"`{name}`" for name in one.opts)
            lines.append(f"| {names} | {told} |")
    return "\n".join([*lines, ""])


class Commands(SphinxDirective):
    """Writes a section for each command."""

    def run(self) -> list[nodes.Node]:
        """Return the sections."""
        program = typer.main.get_command(app)
        text = "\n".join(text_of(words, one) for words, one in leaves(program, "aerobalance"))
        return self.parse_text_to_nodes(text, allow_section_headings=True)


def setup(sphinx: Sphinx) -> dict[str, bool]:
    """Make the directive known to Sphinx."""
    sphinx.add_directive("commands", Commands)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
