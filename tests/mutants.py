"""Whether the tests notice a fault: small ones are put into estimator, identification and matrix, one at a time.

    python tests/mutants.py --count 150 --seed 1 --out build/mutants.json

A sample of all such faults is drawn by the seed. Each is tried in a process of its own, forked with the libraries
loaded, against the tests of its file until the first that fails; what is run again is what the file does not hold yet.
"""

from __future__ import annotations

import argparse
import ast
import importlib.abc
import importlib.util
import io
import json
import os
import random
import signal
import sys
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "aerobalance"
LIMIT = 180
"""Seconds after which a fault counts as noticed: nothing ends any more."""

HOW = "-x -q -p no:xdist -p no:cacheprovider -W ignore::pytest.PytestAssertRewriteWarning"
"""How tests are run; libraries that are loaded already are not rewritten."""

PINNED = "golden/test_golden"
DECAY = ("test_identification_decay", PINNED)
SMOOTHER = ("test_smoother", "test_equations", "test_prior_and_steps", "test_fast_smoother", "test_force", PINNED)
TESTS = {
    "balance/inversion.py": ("test_balance", "test_calibration", PINNED),
    "balance/matrix.py": ("test_balance", "test_calibration", "test_loads", PINNED),
    "estimation/direct.py": ("test_smoother", "test_force", "test_gravity", "test_coupled_baselines", PINNED),
    "estimation/force_smoother.py": (*SMOOTHER, "test_hum", "test_one_model"),
    "estimation/signal_model.py": (*SMOOTHER, "test_hum", "test_colored_force"),
    "estimation/statespace/kalman.py": SMOOTHER,
    "identification/free_decay/fit.py": DECAY,
    "identification/free_decay/ring_fit.py": DECAY,
    "identification/free_decay/waveform.py": DECAY,
}
"""Files that are changed, and the tests that are to notice, the quickest first."""

SWAPS: dict[type, type] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Pow: ast.Mult,
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.And: ast.Or,
    ast.Or: ast.And,
}


LEFT_OUT = (ast.Raise, ast.JoinedStr, ast.Import, ast.ImportFrom)
"""What is said, and what is only named."""


def places(tree: ast.AST) -> Iterator[tuple[ast.AST, str]]:
    """Nodes that can be changed, with the field that is."""
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list"):
            continue
        for node in value if isinstance(value, list) else [value]:
            if not isinstance(node, ast.AST) or isinstance(node, LEFT_OUT):
                continue
            if isinstance(node, ast.BinOp | ast.BoolOp | ast.AugAssign) and type(node.op) in SWAPS:
                yield node, "op"
            elif isinstance(node, ast.Compare) and type(node.ops[0]) in SWAPS:
                yield node, "ops"
            elif isinstance(node, ast.Constant) and type(node.value) in (bool, int, float):
                yield node, "value"
            elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
                yield node, "operand"
            yield from places(node)


def change(node: Any, field: str) -> str:
    """Put a fault into a node; what it was and is."""
    before = ast.unparse(node)
    if field == "op":
        node.op = SWAPS[type(node.op)]()
    elif field == "ops":
        node.ops[0] = SWAPS[type(node.ops[0])]()
    elif field == "operand":
        node.operand = ast.UnaryOp(node.op, node.operand)  # twice, and so not at all
    else:
        value = node.value
        node.value = not value if isinstance(value, bool) else value + 1 if value in (0, int(value)) else 1.5 * value
    return f"{before}  ->  {ast.unparse(node)}"


class Changed(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Has one module loaded from another text."""

    def __init__(self, file: str, text: str) -> None:
        self.name, self.file, self.text = f"aerobalance.{file[:-3].replace('/', '.')}", SOURCE / file, text

    def find_spec(self, fullname: str, path: object, target: object = None) -> Any:
        if fullname != self.name:
            return None
        return importlib.util.spec_from_file_location(fullname, self.file, loader=self)

    def create_module(self, spec: object) -> None:
        return None

    def exec_module(self, module: Any) -> None:
        exec(compile(self.text, str(self.file), "exec"), module.__dict__)


def noticed(file: str, text: str) -> bool:
    """Whether the tests of a file fail with this text of it."""
    child = os.fork()
    if not child:
        code: int = pytest.ExitCode.INTERNAL_ERROR
        try:
            signal.alarm(LIMIT)
            sys.meta_path.insert(0, Changed(file, text))
            paths = [str(ROOT / "tests" / f"{name}.py") for name in TESTS[file]]
            with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
                code = pytest.main([*HOW.split(), *paths])
        finally:
            os._exit(code)
    return os.waitpid(child, 0)[1] != 0


def drawn(count: int, seed: int) -> list[tuple[str, int]]:
    """A sample of files and numbers of their faults."""
    every = [
        (file, number)
        for file in TESTS
        for number, _ in enumerate(places(ast.parse((SOURCE / file).read_text(encoding="utf-8"))))
    ]
    return random.Random(seed).sample(every, count)


def tried(file: str, number: int) -> dict[str, Any]:
    """One fault, and whether it was noticed."""
    tree = ast.parse((SOURCE / file).read_text(encoding="utf-8"))
    node: Any = None
    for place, found in enumerate(places(tree)):
        if place == number:
            node = found
    what = change(*node)
    return {
        "file": file,
        "number": number,
        "line": node[0].lineno,
        "change": what,
        "noticed": noticed(file, ast.unparse(tree)),
    }


def main() -> None:
    """Try the faults that the file does not hold yet, and say how many were noticed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=150)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "mutants.json")
    given = parser.parse_args()
    os.chdir(ROOT)
    for path in (ROOT / "src", ROOT / "tests"):
        sys.path.insert(0, str(path))
    os.environ["AEROBALANCE_SEED"] = "0"
    for name in (
        "hypothesis",
        "numba",
        "numpy",
        "pandas",
        "pydantic",
        "scipy.optimize",
        "scipy.signal",
        "scipy.stats",
    ):
        __import__(name)
    if given.out.exists():
        results = json.loads(given.out.read_text(encoding="utf-8"))
    else:
        results = []
        given.out.parent.mkdir(parents=True, exist_ok=True)
        for file in {tests: file for file, tests in TESTS.items()}.values():
            if noticed(file, (SOURCE / file).read_text(encoding="utf-8")):
                raise SystemExit(f"the tests of {file} fail as it is")
    done = {(row["file"], row["number"]) for row in results}
    for file, number in drawn(given.count, given.seed):
        if (file, number) not in done:
            results.append(tried(file, number))
            part = given.out.with_suffix(".part")
            part.write_text(json.dumps(results, indent=1), encoding="utf-8")
            part.replace(given.out)  # whole at every instant, as this may be stopped
    for row in results:
        if not row["noticed"]:
            print(f"{row['file']}:{row['line']}  {row['change']}")
    print(f"noticed: {sum(row['noticed'] for row in results)} of {len(results)}")


if __name__ == "__main__":
    main()
