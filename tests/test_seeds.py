"""Random numbers of tests: the same at every run, in any order, unless a seed is given."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

pytest_plugins = ["pytester"]

HERE = Path(__file__).parent
DRAWS = """
import pytest
from hypothesis import given, strategies
from seeds import new_seed, trials

@pytest.fixture(scope="module")
def shared():
    return new_seed()

def test_one(shared, rng, seed):
    print("one", rng.integers(10**9), seed, shared, trials(2, 20))

def test_two(shared, rng):
    print("two", rng.integers(10**9), shared)

@given(strategies.integers(0, 10**9))
def test_three(number):
    print("three", number)

@pytest.mark.soak(first=1)
@pytest.mark.parametrize("number", [7, 8])
def test_four(number):
    print("four", number)
"""


@pytest.fixture
def suite(pytester, monkeypatch):
    """A folder for a small suite of tests, with the seeds of this one."""
    monkeypatch.delenv("AEROBALANCE_SEED", raising=False)
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # most plug-ins have no part in this and take seconds
    monkeypatch.setenv("PYTEST_PLUGINS", "_hypothesis_pytestplugin,xdist.plugin")
    (pytester.path / "seeds.py").write_text((HERE / "seeds.py").read_text(encoding="utf-8"), encoding="utf-8")
    pytester.makeconftest('pytest_plugins = ["seeds"]')
    return pytester


@pytest.fixture
def drawn(suite):
    """What the tests of a small suite draw, by name, when it is run with some arguments."""
    suite.makepyfile(test_draws=DRAWS)

    def run(*given: str) -> dict[str, list[str]]:
        result = suite.runpytest_subprocess("-s", "-q", "-p", "no:cacheprovider", *given)
        assert result.ret == 0, result.outlines
        found: dict[str, list[str]] = {}
        for line in result.outlines:
            if said := re.search(r"(one|two|three|four) (\d.*)", line):
                found.setdefault(said[1], []).append(said[2])
        return found

    return run


def test_numbers_are_the_same_at_every_run_and_in_any_order(drawn) -> None:
    whole = drawn()
    turned = drawn(*(f"test_draws.py::test_{name}" for name in ("four", "three", "two", "one")))
    assert list(turned) == ["four", "three", "two", "one"]
    assert turned == whole
    first, second, shared, trials = whole["one"][0].split()
    assert len({first, second, shared, *whole["two"][0].split()}) == 4  # that of the fixture is the same in both
    assert trials == "2"


def test_a_seed_from_outside_gives_others_and_brings_them_back(drawn, monkeypatch) -> None:
    fixed, other = drawn(), drawn("--seed", "123")
    for name in ("one", "two", "three"):
        assert other[name] != fixed[name]
    assert other["one"][0].endswith(" 20")
    assert (fixed["four"], other["four"]) == (["7"], ["7", "8"])
    monkeypatch.setenv("AEROBALANCE_SEED", "123")
    assert drawn() == other


def test_a_failure_says_how_to_bring_it_back(suite) -> None:
    suite.makepyfile(test_fails="def test_it(seed):\n    assert seed is None\n")
    result = suite.runpytest_subprocess("-q", "-n", "1", "--seed", "fresh")
    assert result.ret == 1
    said = result.stdout.str()
    again = re.search(r"bring it back with: python -m pytest (--seed \d+) 'test_fails\.py::test_it'", said)
    failed = re.search(r"assert (\d+) is None", said)
    assert failed[0] in suite.runpytest_subprocess("-q", *again[1].split()).stdout.str()


def test_a_seed_that_is_no_number_is_refused(suite) -> None:
    result = suite.runpytest_subprocess("--seed", "abc")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert "take a whole number" in result.stderr.str()


# what a call that draws by itself begins with: only a file that has it somewhere is taken apart
DRAWS_BY_ITSELF = re.compile(
    r"(default_rng|SeedSequence|Random|RandomState)\(\s*\)|random\.(?!default_rng)[a-z_]+\(|secrets\.|SystemRandom|urandom|uuid[14]"
)


def test_no_test_draws_elsewhere() -> None:
    found = [
        f"{file.name}: {ast.unparse(node)}"
        for file in sorted(HERE.rglob("*.py"))
        for text in [file.read_text(encoding="utf-8")]
        if DRAWS_BY_ITSELF.search(text)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call) and draws_by_itself(ast.unparse(node.func), node.args + node.keywords)
    ]
    assert found == ["seeds.py: secrets.randbits(32)"]


def draws_by_itself(function: str, arguments: list) -> bool:
    """Whether a call draws random numbers that follow from no seed of ours."""
    if function.rpartition(".")[2] in {"default_rng", "SeedSequence", "Random", "RandomState"}:
        return not arguments
    own = r"(np|numpy)\.random\.[a-z_]+|(random|secrets)\.[a-z_]+|random\.SystemRandom|os\.urandom|uuid\.uuid[14]"
    return re.fullmatch(own, function) is not None
