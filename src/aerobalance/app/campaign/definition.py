r"""The test file: TOML that says which runs a test has, and which zeros, balance and dynamics go with each.

::

    name = "wing A, tunnel 1"

    [runs]
    files = "runs/*.h5"                                # names, patterns, or addresses such as s3://bucket/runs/*.h5
    pattern = 'run_(?P<run>\d+)_a(?P<alpha>[-\d.]+)\.h5'  # what the names say, as columns
    table = "runs.csv"                                 # or more columns by file: file, alpha, q, polar ...

    [[setups]]                                         # the first holds from the beginning
    balance = "balance.json"
    dynamics = "dynamics.json"
    map = "map.toml"

    [[setups]]
    from = 201                                         # of the column run, or a date of the column date
    balance = "balance_2.json"

    [zeros]
    files = "zeros/zero_*.h5"
    pattern = 'zero_(?P<polar>\d+)'
    match = ["polar"]
    model_on = true
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import date, datetime
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field, ValidationError, field_validator, model_validator

from aerobalance.io.channel_settings import NotBelow, Number, Strict
from aerobalance.io.measure import LARGEST
from aerobalance.io.messages import first_fault
from aerobalance.io.toml_file import read_toml
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.errors import ReadError

Above = Annotated[float, Field(gt=0, le=LARGEST, allow_inf_nan=False)]
FileName = Annotated[str, Field(min_length=1, max_length=1000)]
Column = Annotated[str, Field(min_length=1, max_length=60)]
Cell = str | int | float | bool
Names = FileName | Annotated[list[FileName], Field(min_length=1)]
ModelOn = Literal["auto"] | bool

FILE_COLUMNS: Final = ("file", "zero", "zero_after", "tare", "balance", "dynamics", "map")
"""Columns of the table of runs that name files."""


def _as_pattern(given: str | None) -> str | None:
    """Refuse what is no regular expression, or says nothing."""
    if given is None:
        return None
    try:
        found = re.compile(given)
    except re.error as error:
        raise ValueError(f"must be a regular expression ({error})") from None
    if not found.groupindex:
        raise ValueError("must have named groups such as (?P<alpha>[-0-9.]+), which become columns")
    return given


class RunFiles(Strict):
    """Table ``[runs]``: which files are runs, and what is known of each."""

    files: Names | None = None
    pattern: str | None = None
    table: FileName | None = None
    rows: list[dict[Column, Cell]] = Field(default_factory=list)
    exclude: Names | None = None

    _regular = field_validator("pattern")(_as_pattern)

    @model_validator(mode="after")
    def _some(self) -> RunFiles:
        if self.files is None and self.table is None and not self.rows:
            raise ValueError("needs files (names or a pattern such as runs/*.h5), table, or rows with a key file each")
        if any(not isinstance(row.get("file"), str) for row in self.rows):
            raise ValueError("each of rows needs a key file, the name of a recording")
        return self


class Placed(Strict):
    """Where one frame is in another: point aft, right, up [m], and angles [deg]."""

    point: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    pitch: Number = 0.0
    roll: Number = 0.0
    yaw: Number = 0.0
    u_point: NotBelow = 0.0
    u_angle: NotBelow = 0.0

    @field_validator("point", mode="before")
    @classmethod
    def _three(cls, given: object) -> object:
        return three_numbers(given)


def three_numbers(given: object) -> object:
    """Take a list of three numbers for a point."""
    if isinstance(given, list | tuple) and len(given) == 3 and all(type(one) in (int, float) for one in given):
        return tuple(float(one) for one in given)
    raise ValueError("must be three numbers [aft, right, up] in m")


class Axes(Strict):
    """Table ``[axes]``: the body's axes in the balance, and the moment centre in the body [m]."""

    body: Placed = Placed()
    moment_centre: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    u_moment_centre: NotBelow = 0.0

    @field_validator("moment_centre", mode="before")
    @classmethod
    def _three(cls, given: object) -> object:
        return three_numbers(given)


def instant(given: str | date) -> date:
    """Return a date, or a date with time, of its text.

    Raises
    ------
    ValueError
        It is none.
    """
    if isinstance(given, date):
        return given
    try:
        return datetime.fromisoformat(given) if len(given) > 10 else date.fromisoformat(given)
    except ValueError:
        raise ValueError(f"must be a date such as 2026-03-12 or 2026-03-12T10:15, not {given!r}") from None


class SetUp(Strict):
    """Table ``[[setups]]``: what holds from a run or a date on, or for runs with given columns; later ones win."""

    since: int | float | str | datetime | date | None = Field(default=None, alias="from")
    where: dict[Column, Cell] = Field(default_factory=dict)
    balance: FileName | None = None
    dynamics: FileName | None = None
    map: FileName | None = None
    noise_record: FileName | None = None
    axes: Axes | None = None

    @field_validator("since")
    @classmethod
    def _date(cls, given: object) -> object:
        if isinstance(given, str):
            try:
                instant(given)
            except ValueError as problem:
                raise ValueError(f"{problem}; a number of run is written without quotes") from None
        return given


class ZeroFiles(Strict):
    """Table ``[zeros]``: recordings without wind that the loads count from."""

    files: Names | None = None
    pattern: str | None = None
    match: list[Column] = Field(default_factory=list)
    use: Literal["before", "around", "all"] = "before"
    model_on: ModelOn = "auto"

    _regular = field_validator("pattern")(_as_pattern)


class Tares(Strict):
    """Table ``[tares]``: wind-off recordings whose loads are taken off at the same attitude."""

    files: Names
    pattern: str | None = None
    match: list[Column] = Field(default_factory=list)

    _regular = field_validator("pattern")(_as_pattern)


class Reference(Strict):
    """Table ``[reference]``: area [m^2], chord of the pitching moment and span of the other moments [m]."""

    area: Above
    chord: Above
    span: Above


class Pressure(Strict):
    """Table ``[pressure]``: the dynamic pressure [Pa] as a number, a column of the table, or a channel (its mean).

    `u` is a standard uncertainty that is the same error in all runs, `u_run` one that is drawn anew in each [Pa].
    """

    value: Above | None = None
    column: Column | None = None
    channel: Column | None = None
    u: NotBelow = 0.0
    u_run: NotBelow = 0.0

    @model_validator(mode="after")
    def _one(self) -> Pressure:
        given = [name for name in ("value", "column", "channel") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError("needs one of value [Pa], column (of the table of runs) and channel (of the recordings)")
        return self


class Angles(Strict):
    """Table ``[angles]``: columns of angle of attack and sideslip [deg]; pitch and roll of the recording if left out.

    `u` is a standard uncertainty that is the same error in all runs, `u_run` one that is drawn anew in each [deg].
    """

    alpha: Column | None = None
    beta: Column | None = None
    u: NotBelow = 0.0
    u_run: NotBelow = 0.0


class Repeats(Strict):
    """Table ``[repeats]``: runs are repeats of each other where these columns agree, within a tolerance."""

    by: Annotated[list[Column], Field(min_length=1)] = Field(default_factory=lambda: ["alpha", "beta"])
    tolerance: dict[Column, NotBelow] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _of_columns_that_count(self) -> Repeats:
        others = [name for name in self.tolerance if name not in self.by]
        if others:
            raise ValueError(
                f"tolerance is given for {', '.join(others)}, in which runs need not agree; give it for one of by "
                f"({', '.join(self.by)}), or add {others[0]} to by"
            )
        return self


class ForceOptions(Strict):
    """Table ``[force]``: how the force is worked out, as the options of the command force."""

    method: Literal["smoother", "paper"] = "smoother"
    bandwidth: Above | None = None
    u_gravity: NotBelow = 0.0
    hum: Literal["mains", "keep"] | list[Above] = "mains"
    keep_outliers: bool = False
    align: bool = False


class SpectrumBands(Strict):
    """Table ``[spectrum]``: bands whose rms each run gets a column of [Hz]."""

    bands: list[tuple[NotBelow, Above]] = Field(default_factory=lambda: [(1.0, 10.0), (10.0, 100.0), (100.0, 1000.0)])

    @field_validator("bands", mode="before")
    @classmethod
    def _pairs(cls, given: object) -> object:
        pairs = isinstance(given, list) and all(isinstance(one, list) and len(one) == 2 for one in given)
        if isinstance(given, list) and pairs and all(one[0] < one[1] for one in given):
            return [(float(one[0]), float(one[1])) for one in given]
        raise ValueError("must be pairs of frequencies in Hz, the lower first, such as [[1, 10], [10, 100]]")


class Output(Strict):
    """Table ``[output]``: what is written beside the summary."""

    histories: bool = True
    reports: Literal["all", "doubtful", "none"] = "all"


class Definition(Strict):
    """A test: its runs and all that goes with them."""

    name: Annotated[str, Field(max_length=200)] = ""
    notes: Annotated[str, Field(max_length=10_000)] = ""
    gravity: Annotated[float, Field(ge=9.7, le=9.9)] = STANDARD_GRAVITY
    runs: RunFiles
    setups: Annotated[list[SetUp], Field(min_length=1)]
    zeros: ZeroFiles | None = None
    tares: Tares | None = None
    axes: Axes = Axes()
    reference: Reference | None = None
    pressure: Pressure | None = None
    angles: Angles = Angles()
    repeats: Repeats = Repeats()
    force: ForceOptions = ForceOptions()
    spectrum: SpectrumBands = SpectrumBands()
    output: Output = Output()

    @model_validator(mode="after")
    def _consistent(self) -> Definition:
        if self.reference is not None and self.pressure is None:
            raise ValueError("reference: coefficients need [pressure] too, the dynamic pressure")
        return self


def load_definition(path: Path | str, *, dynamics: str | None = None) -> Definition:
    """Read a test file.

    Parameters
    ----------
    path
        The file.
    dynamics
        Dynamics of runs for which the file names none.

    Raises
    ------
    ReadError
        The file is no TOML, or has a key that is unknown, missing or not allowed; the message names the key.
    """
    file = Path(path)
    return definition_from(read_toml(file, what="a test file"), file, dynamics=dynamics)


def definition_from(given: Mapping[str, Any], path: Path | str = "test", *, dynamics: str | None = None) -> Definition:
    """Make a definition of plain data, as a test file holds it.

    Raises
    ------
    ReadError
        As `load_definition`.
    """
    contents = dict(given)
    if dynamics is not None:
        before = contents.get("setups", [])
        contents["setups"] = [{"dynamics": dynamics}, *(before if isinstance(before, list) else [before])]
    try:
        return Definition.model_validate(contents)
    except ValidationError as error:
        where, what = first_fault(error, Definition)
        fault = error.errors(include_url=False)[0]
        if fault["type"] == "value_error":
            what = fault["msg"].removeprefix("Value error, ")
        raise ReadError(path, where, what) from None
