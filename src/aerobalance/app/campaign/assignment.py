"""What belongs to each run of a test: its columns, balance, dynamics, channel map, zeros and tares."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date, datetime
from pathlib import Path
from typing import Final

from aerobalance.app.campaign.definition import (
    FILE_COLUMNS,
    Axes,
    Cell,
    Definition,
    ModelOn,
    Names,
    SetUp,
    instant,
)
from aerobalance.app.campaign.places import folder_of, is_address, joined, listed, matching, name_of
from aerobalance.app.campaign.run_table import cell, check_numbers, read_rows
from aerobalance.recording.errors import FitError, ReadError

NO_RECORDINGS: Final = frozenset({".json", ".toml", ".html", ".md", ".pdf", ".py", ".png", ".jpg", ".svg", ".log"})
"""Endings of files that are no runs where a folder is given."""

OF_RESULTS: Final = re.compile(
    "run_name|place|setup|(zero|tare)_from|(balance|dynamics)_file|status|reason|verdict|doubts|doubt_kinds|warnings|report|lacking"
    "|duration_s|rate_Hz|samples|alpha_deg|beta_deg|pressure_Pa|steps_.*|resolved_to_.*|natural_frequency_.*"
    "|((u|u_run|u_zero|u_tare|dof)_)?(C(NF|PM|SF|YM|RM|AF|L|D|Y)|C[PYR]M_wind"
    "|(balance|body|wind|rms|largest|largest_step|least|sample|zero|zero_drift)_.*_(N|Nm)|[kb]_change_.*)"
)
"""Names of columns that a result has by itself."""

ANGLES: Final = ("alpha", "beta")
"""Columns that are those of the recording where no table has them."""


@dataclass(frozen=True, slots=True)
class Run:
    """A run of a test, with all that it is reduced with.

    Attributes
    ----------
    name
        What it is called: the name of its file without the ending.
    place
        Its number in the order of the test, from 1.
    file
        Its recording.
    columns
        What table and file name say of it.
    dynamics, balance, channel_map, noise_record
        The files that it is reduced with; None where there is none.
    zeros, zeros_after, tares
        Recordings without wind.
    model_on
        Whether the model hung on the balance while the zeros were read.
    axes
        Axes of the body, and moment centre.
    setup
        Which of the set-ups holds, from 0.
    fault
        Why nothing can be worked out; empty where all is there.
    """

    name: str
    place: int
    file: str
    columns: Mapping[str, Cell] = field(default_factory=dict)
    dynamics: str | None = None
    balance: str | None = None
    channel_map: str | None = None
    noise_record: str | None = None
    zeros: tuple[str, ...] = ()
    zeros_after: tuple[str, ...] = ()
    tares: tuple[str, ...] = ()
    model_on: ModelOn = "auto"
    axes: Axes = field(default_factory=Axes)
    setup: int = 0
    fault: str = ""

    @property
    def inputs(self) -> tuple[str, ...]:
        """All files that its result hangs on, each once."""
        single = (self.file, self.dynamics, self.balance, self.channel_map, self.noise_record)
        every = (*(one for one in single if one is not None), *self.zeros, *self.zeros_after, *self.tares)
        return tuple(dict.fromkeys(every))


@dataclass(frozen=True, slots=True)
class Marked:
    """A file with what its name and the table say of it."""

    file: str
    columns: Mapping[str, Cell]


def definition_of_folder(folder: str, dynamics: str, *, balance: str | None = None) -> Definition:
    """Return the test that all recordings of a folder are, without any table."""
    files = [name_of(one) for one in listed(folder) if Path(name_of(one)).suffix.lower() not in NO_RECORDINGS]
    if not files:
        raise ReadError(folder, "", "holds no recordings")
    set_up = SetUp.model_validate({"dynamics": dynamics, "balance": balance})
    return Definition.model_validate({"runs": {"files": files}, "setups": [set_up.model_dump(by_alias=True)]})


def assigned(definition: Definition, folder: str) -> tuple[Run, ...]:
    """Return the runs of a test in its order, with what belongs to each.

    Parameters
    ----------
    definition
        The test.
    folder
        Folder of its file, which names in it count from.

    Raises
    ------
    ReadError
        No file is a run, the table cannot be read, or a name that is given once for all is missing.
    """
    marked = _in_order(_runs(definition, folder))
    _check_columns(definition, marked)
    zeros = _in_order(_files(definition.zeros.files, definition.zeros.pattern, folder)) if definition.zeros else []
    tares = _in_order(_files(definition.tares.files, definition.tares.pattern, folder)) if definition.tares else []
    names = _names([one.file for one in marked])
    return tuple(
        _with_all(definition, folder, name=name, place=place, marked=one, zeros=zeros, tares=tares)
        for place, (name, one) in enumerate(zip(names, marked, strict=True), start=1)
    )


def _check_columns(definition: Definition, marked: Sequence[Marked]) -> None:
    """Make sure that set-ups are chosen, and repeats compared, by columns that there are."""
    there = dict.fromkeys(key for one in marked for key in one.columns)
    named = [(f"setups[{number}].where", key) for number, one in enumerate(definition.setups) for key in one.where]
    named += [
        ("repeats.by", key) for key in definition.repeats.by if key not in ANGLES and not OF_RESULTS.fullmatch(key)
    ]
    for where, key in named:
        if key not in there:
            what = f"names {key}, which no run has as a column; there are: {', '.join(there) or 'none'}"
            raise ReadError("test", where, what)


def _with_all(
    definition: Definition,
    folder: str,
    *,
    name: str,
    place: int,
    marked: Marked,
    zeros: Sequence[Marked],
    tares: Sequence[Marked],
) -> Run:
    columns = marked.columns
    faults = []
    try:
        chosen, setup = _setup(definition.setups, columns)
    except FitError as problem:
        chosen, setup = {}, 0
        faults.append(str(problem))

    def own(key: str) -> str | None:
        given = columns.get(key)
        found = given if isinstance(given, str) and given else chosen.get(key)
        return None if found is None else joined(folder, str(found))

    def several(key: str) -> tuple[str, ...]:
        given = columns.get(key)
        parts = [part.strip() for part in str(given).split("|")] if given not in (None, "") else []
        return tuple(joined(folder, part) for part in parts)

    before, after = several("zero"), several("zero_after")
    if definition.zeros is not None and not before and definition.zeros.files is not None:
        try:
            before, after = _zeros_of(definition, marked, zeros)
        except FitError as problem:
            faults.append(str(problem))
    wind_off = several("tare")
    if definition.tares is not None and not wind_off:
        wind_off = tuple(one.file for one in tares if _agree(one, marked, definition.tares.match))
        if not wind_off:
            faults.append(f"no wind-off recording of [tares] agrees in {', '.join(definition.tares.match)}")
    if own("dynamics") is None and not faults:
        faults.append("no dynamics are given: name them under [[setups]], in a column dynamics, or with --dynamics")
    axes = chosen.get("axes")
    return Run(
        name=name,
        place=place,
        file=marked.file,
        columns={key: value for key, value in columns.items() if key not in FILE_COLUMNS},
        dynamics=own("dynamics"),
        balance=own("balance"),
        channel_map=own("map"),
        noise_record=own("noise_record"),
        zeros=before,
        zeros_after=after,
        tares=wind_off,
        model_on="auto" if definition.zeros is None else definition.zeros.model_on,
        axes=axes if isinstance(axes, Axes) else definition.axes,
        setup=setup,
        fault="; ".join(faults),
    )


def _setup(setups: Sequence[SetUp], columns: Mapping[str, Cell]) -> tuple[dict[str, object], int]:
    """What the set-ups say of a run, and the last of them that holds.

    Raises
    ------
    FitError
        The run does not say what it takes to tell whether one holds.
    """
    chosen: dict[str, object] = {}
    last = 0
    for number, one in enumerate(setups):
        if any(not _same(columns.get(key), wanted) for key, wanted in one.where.items()):
            continue
        if not _reached(one.since, columns):
            continue
        given = {key: getattr(one, key) for key in ("balance", "dynamics", "map", "noise_record", "axes")}
        chosen |= {key: value for key, value in given.items() if value is not None}
        last = number
    return chosen, last


def _reached(since: int | float | str | date | None, columns: Mapping[str, Cell]) -> bool:
    """Whether a run comes at or after a number of run or a date."""
    if since is None:
        return True
    if isinstance(since, int | float):
        number = columns.get("run")
        if not isinstance(number, int | float):
            raise FitError(
                f"a set-up holds from run {since:g} on, and this run has no number: give it one in a column run (or a "
                "group run in the pattern)"
            )
        return number >= since
    given = columns.get("date")
    if not isinstance(given, str):
        raise FitError(f"a set-up holds from {since} on, and this run has no date: give it one in a column date")
    try:
        return _not_before(instant(given), instant(since))
    except ValueError as problem:
        raise FitError(f"a set-up holds from {since} on, and the run is of {given}: {problem}") from None


def _not_before(given: date, since: date) -> bool:
    """Whether a date, or a date with time, is that of another or comes after it.

    Raises
    ------
    ValueError
        That cannot be told.
    """
    if not isinstance(since, datetime):
        return (given.date() if isinstance(given, datetime) else given) >= since
    if not isinstance(given, datetime):
        if given == since.date():
            raise ValueError("give the time too")
        return given > since.date()
    if (given.tzinfo is None) != (since.tzinfo is None):
        raise ValueError("give both with a time zone, or none")
    return given >= since


def _same(one: Cell | None, other: Cell | None) -> bool:
    """Whether two cells say the same, be it as number or as text."""
    return one is not None and other is not None and (one == other or str(one) == str(other))


def _agree(one: Marked, run: Marked, columns: Sequence[str]) -> bool:
    return all(_same(one.columns.get(key), run.columns.get(key)) for key in columns)


def _zeros_of(definition: Definition, run: Marked, zeros: Sequence[Marked]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Zeros before and after a run.

    Raises
    ------
    FitError
        There are none, or it is not said which.
    """
    rules = definition.zeros
    if rules is None:
        return (), ()
    agreed = [one for one in zeros if _agree(one, run, rules.match)]
    match = f" that agrees in {', '.join(rules.match)}" if rules.match else ""
    if not agreed:
        raise FitError(f"there is no zero{match}")
    number = run.columns.get("run")
    numbers = [one.columns.get("run") for one in agreed]
    if rules.use == "all" or len(agreed) == 1:
        return tuple(one.file for one in agreed), ()
    if not isinstance(number, int | float) or not all(isinstance(one, int | float) for one in numbers):
        raise FitError(
            f"{len(agreed)} zeros{match} could be meant: say which by zeros.match, by a column zero, or by numbers of "
            "run (a group run in the patterns of runs and zeros)"
        )
    pairs = [(float(str(other)), one.file) for other, one in zip(numbers, agreed, strict=True)]
    earlier = [pair for pair in pairs if pair[0] <= number]
    later = [pair for pair in pairs if pair[0] > number]
    if not earlier:
        raise FitError(f"there is no zero{match} before run {number:g}")
    after = (min(later)[1],) if later and rules.use == "around" else ()
    return (max(earlier)[1],), after


def _runs(definition: Definition, folder: str) -> list[Marked]:
    """The runs with their columns, in the order in which they are given."""
    rules = definition.runs
    excluded = {name_of(place) for pattern in _each(rules.exclude) for place in matching(folder, pattern)}
    found: dict[str, dict[str, Cell]] = {}
    if rules.files is not None:
        for one in _files(rules.files, rules.pattern, folder, optional=rules.pattern is not None):
            found[one.file] = dict(one.columns)
    by_name = {name_of(file): file for file in found}
    base = folder
    for number, row in enumerate(rules.rows):
        check_numbers(row, folder, f"runs.rows[{number}]", written={})
    rows = [("rows", row) for row in rules.rows]
    if rules.table is not None:
        table = joined(folder, rules.table)
        base = folder_of(table)
        rows = [*((f"line {line}", row) for line, row in read_rows(table)), *rows]
    for where, row in rows:
        name = str(row["file"])
        given = joined(folder if where == "rows" else base, name)
        file = given if given in found else by_name.get(name_of(name), given)
        if rules.files is not None and file not in found:
            known = is_address(file) or Path(file).exists()
            if not known:
                raise ReadError(rules.table or "test", where, f"names {name}, which is not there")
        before = found.get(file, {})
        if rules.pattern is not None and not before:
            before = _said(rules.pattern, file) or {}
        found[file] = {**before, **{key: value for key, value in row.items() if key != "file" and value != ""}}
    kept = [Marked(file, columns) for file, columns in found.items() if name_of(file) not in excluded]
    if not kept:
        raise ReadError(folder, "runs", "no file is a run: check files, table and exclude")
    taken = {definition.angles.alpha, definition.angles.beta, definition.pressure and definition.pressure.column}
    for one in kept:
        clash = sorted(name for name in one.columns if name not in taken and OF_RESULTS.fullmatch(name))
        if clash:
            raise ReadError(folder, "runs", f"a column cannot be called {clash[0]}: results have one of that name")
    return kept


def _each(names: Names | None) -> list[str]:
    return [] if names is None else [names] if isinstance(names, str) else list(names)


def _files(names: Names | None, pattern: str | None, folder: str, *, optional: bool = False) -> list[Marked]:
    """Files by names and patterns, with what their own names say."""
    places = [place for name in _each(names) for place in matching(folder, name)]
    if names is not None and not places:
        raise ReadError(folder, "", f"no file is named by {', '.join(_each(names))}")
    found = []
    for place in dict.fromkeys(places):
        said = {} if pattern is None else _said(pattern, place)
        if said is None and not optional:
            raise ReadError(place, "", f"has a name that the pattern {pattern!r} does not fit")
        found.append(Marked(place, said or {}))
    return found


def _said(pattern: str, place: str) -> dict[str, Cell] | None:
    """What the name of a file says by a pattern; None where it does not fit."""
    match = re.search(pattern, place.replace("\\", "/"))
    if match is None:
        return None
    written = {key: value for key, value in match.groupdict().items() if value is not None}
    cells = {key: cell(value) for key, value in written.items()}
    check_numbers(cells, place, "its name", written=written)
    return cells


def _in_order(marked: Iterable[Marked]) -> list[Marked]:
    """Files in the order of their number of run, where all have one; else as they are given."""
    every = list(marked)
    numbers = [one.columns.get("run") for one in every]
    if every and all(isinstance(number, int | float) for number in numbers):
        return sorted(every, key=lambda one: float(str(one.columns["run"])))
    return every


def _names(files: Sequence[str]) -> list[str]:
    """What runs are called: the names of their files without the ending, with the folder where two are alike."""
    short = [_plain(Path(name_of(file)).stem) for file in files]
    if len({name.lower() for name in short}) == len(short):
        return short
    long = [_plain("_".join([*Path(file.partition("://")[2] or file).parts[-2:]])) for file in files]
    first: dict[str, str] = {}
    for name, file in zip(long, files, strict=True):
        if name.lower() in first:
            other = first[name.lower()]
            raise ReadError(file, "", f"its run and that of {other} would both be called {name}; give it another name")
        first[name.lower()] = file
    return long


def _plain(name: str) -> str:
    """The name of a run as that of a file and a group."""
    return re.sub(r"[^\w.+\-]", "_", name).strip(".") or "_"
