"""The documentation says what is there: public names, commands, equations, works cited."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections import Counter
from typing import Any

import pytest
import typer

import aerobalance as ab
from aerobalance.app.cli.program import app
from helpers.full_names import at
from helpers.pages import PAGES, README, ROOT, commands, python

API = (ROOT / "docs/api.md").read_text(encoding="utf-8")
DOCUMENTED = re.findall(r"auto(?:function|class|exception):: ([\w.]+)$", API, re.MULTILINE)

UNIT = re.compile(r"\[[^\]]+\]|in\s+the (same )?units?\b|in `unit`|^See `")
"""What tells the unit of a number, or where it is told."""


def sections(thing: Any) -> dict[str, dict[str, str]]:
    """What a numpydoc docstring says of each name, by section."""
    found: dict[str, dict[str, str]] = {}
    parts = re.split(r"^(.+)\n-{3,}$", inspect.getdoc(thing) or "", flags=re.MULTILINE)
    for title, body in zip(parts[1::2], parts[2::2], strict=True):
        entries = re.split(r"^(?=\S)", body, flags=re.MULTILINE)
        rows = [entry.split("\n", 1) for entry in entries if "\n" in entry.strip("\n")]
        found[title.strip()] = {
            name.strip().strip("*"): textwrap.dedent(text) for names, text in rows for name in names.split(",")
        }
    return found


def numbers(annotation: str) -> bool:
    """Whether an annotation is of quantities: real numbers or arrays of them."""
    return bool({"float", "Array", "ArrayLike"} & set(re.findall(r"\w+", annotation)))


def test_every_public_name_stands_in_the_reference():
    assert {f"aerobalance.{name}" for name in ab.__all__} <= set(DOCUMENTED)


@pytest.mark.parametrize("path", DOCUMENTED)
def test_arguments_are_documented_with_units(path):
    thing = at(path)
    documented = sections(thing)
    first = (inspect.getdoc(thing) or "").splitlines()[0]
    assert first.endswith((".", ":")), first
    if inspect.isfunction(thing) or path == "aerobalance.LiveForce":
        said = documented["Parameters"]
        arguments = inspect.signature(thing).parameters
        assert set(arguments) == set(said), set(arguments) ^ set(said)
        given = {name: str(one.annotation) for name, one in arguments.items()}
    elif hasattr(thing, "__dataclass_fields__"):
        said = documented["Attributes"]
        given = {name: str(one.type) for name, one in thing.__dataclass_fields__.items() if not name.startswith("_")}
        own = set(given) & set(ast_fields(thing))  # fields of a base are documented there
        assert own <= set(said), own - set(said)
        given = {name: kind for name, kind in given.items() if name in own}
    else:
        return
    for name, kind in given.items():
        if numbers(kind):
            assert UNIT.search(said[name]), (name, said[name])


def ast_fields(thing: type) -> list[str]:
    """Names of the fields that a class defines itself."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(thing))).body[0]
    assert isinstance(tree, ast.ClassDef)
    return [row.target.id for row in tree.body if isinstance(row, ast.AnnAssign) and isinstance(row.target, ast.Name)]


def test_every_equation_is_written_once_under_its_number():
    written = Counter(number for page in PAGES for number in re.findall(r"\\tag\{(\d+)\}", page.read_text("utf-8")))
    assert written == Counter(str(number) for number in {*range(1, 21)} - {4, 5, 9, 10})


def test_works_cited_are_those_of_the_bibliography():
    def works(text: str) -> dict[str, str]:
        rows = re.findall(r"^ *\.\. \[(\w+)\] (.*?)(?=\n *\n|\n *\.\. \[|\n *\"\"\"|\n```|\"\"\"$)", text, re.M | re.S)
        return {key: " ".join(body.split()).removesuffix('"""').removeprefix("\\") for key, body in rows}

    listed = works((ROOT / "docs/references.md").read_text(encoding="utf-8"))
    cited: dict[str, str] = {}
    for path in (ROOT / "src").rglob("*.py"):
        for key, body in works(path.read_text(encoding="utf-8")).items():
            assert listed.get(key) == body, (path, key)
            cited[key] = body
    assert listed == cited


def shown() -> list[tuple[str, str]]:
    """Every command of README and pages, with its page."""
    return [(page.name, line) for page in [README, *PAGES] for line in commands(page.read_text(encoding="utf-8"))]


def test_commands_that_are_shown_exist_with_their_options():
    program = typer.main.get_command(app)
    lines = shown()
    assert len(lines) > 50
    for page, line in lines:
        words = line.split("|")[0].split()[1:]
        command: Any = program
        while words and words[0] in getattr(command, "commands", {}):
            command = command.commands[words.pop(0)]
        assert command is not program or words[0].startswith("-"), (page, line)
        known = {"--help", *(name for one in command.params for name in [*one.opts, *one.secondary_opts])}
        known |= {"--install-completion"} if command is program else set()
        used = {word.split("=")[0] for word in words if re.match(r"-{1,2}[a-z]", word)}
        assert used <= known, (page, line)


def test_python_that_is_shown_is_python_with_names_that_exist():
    for page in [README, *PAGES]:
        for block in python(page.read_text(encoding="utf-8")):
            ast.parse(block)
            assert set(re.findall(r"\bab\.(\w+)", block)) <= {*ab.__all__, "__version__"}, (page.name, block)


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "SECURITY.md"])
def test_links_of_the_first_pages_lead_somewhere(name):
    targets = re.findall(r"\]\((?!https?:)([^)#]+)", (ROOT / name).read_text(encoding="utf-8"))
    assert [target for target in targets if not (ROOT / target).exists()] == []


def test_figures_of_peers_in_the_paper_are_those_of_the_documentation():
    def cells(path: str) -> list[list[str]]:
        text = (ROOT / path).read_text(encoding="utf-8").split("PyDynamic FIR |")[1].split("\n\n")[0]
        return [[cell.strip() for cell in row.split("|")[2:-1]] for row in text.splitlines() if "-0." in row]

    assert cells("paper/paper.md") == cells("docs/compare.md")
    assert len(cells("paper/paper.md")) == 2


INVENTORIES = sorted((ROOT / "docs/inventories").glob("*.txt"))


@pytest.mark.parametrize("inventory", INVENTORIES, ids=lambda path: path.stem)
def test_names_of_other_projects_that_are_kept_for_a_build_without_network_exist(inventory):
    header, rows = (inventory.read_text(encoding="utf-8").splitlines()[part] for part in (slice(3), slice(3, None)))
    assert header[0] == "# Sphinx inventory version 1"
    assert rows
    for name, _, page in (row.split() for row in rows):
        assert name.startswith(f"{inventory.stem}.")
        assert at(name) is not None, name
        assert page.endswith(".html")


def test_the_version_to_cite_is_the_present_one():
    assert f"\nversion: {ab.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_sentences_of_the_readme_are_short():
    prose = re.sub(r"^```.*?^```|^\|.*?$|^#.*?$", "", README.read_text(encoding="utf-8"), flags=re.M | re.S)
    for sentence in re.split(r"[.:;]\s+|\n\n|\n- ", prose):
        assert len(sentence.split()) <= 40, sentence
