"""How the modules import each other: whatever a contract on layers leaves open within a package."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import aerobalance

ROOT = Path(aerobalance.__file__).parent


def modules() -> dict[str, Path]:
    names = {}
    for path in ROOT.rglob("*.py"):
        parts = path.relative_to(ROOT.parent).with_suffix("").parts
        names[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return names


def imported(path: Path, known: dict[str, Path]) -> set[str]:
    """Modules of the package that a file imports anywhere: also within functions, and for types alone."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0 and node.module is not None, path
            parts = {alias.name: f"{node.module}.{alias.name}" for alias in node.names if alias.name != "__version__"}
            found |= {part if part in known else node.module for part in parts.values()}
    return found & set(known)


def test_no_modules_import_each_other_in_a_circle():
    known = modules()
    graph = {name: imported(path, known) - {name} for name, path in known.items()}
    assert "aerobalance.recording.errors" in graph["aerobalance.recording.recording"]  # so that imports are seen
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as problem:
        raise AssertionError(" -> ".join(problem.args[1])) from None
