"""Options that several commands share."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Final

import typer

PROGRAM: Final = "aerobalance"

Json = Annotated[bool, typer.Option("--json", help="Print the result as one JSON object on standard output.")]
Out = Annotated[Path | None, typer.Option("-o", "--out", help="Where to write the result.")]
NeededOut = Annotated[
    Path, typer.Option("-o", "--out", help="Where to write the result; the ending chooses the format.")
]
Modes = Annotated[str, typer.Option("--modes", help="How many modes: a number, or auto for those the data show.")]
Component = Annotated[str, typer.Option("--component", help="Which component: NF, PM, SF, YM, RM or AF.")]
Gravity = Annotated[float, typer.Option("--gravity", help="Local acceleration of gravity in m/s^2.", min=9.7, max=9.9)]
Map = Annotated[
    Path | None, typer.Option("--map", help="Channel map (TOML) that says what a foreign file's columns are.")
]
Mass = Annotated[str, typer.Option("--mass", help="Moving mass in kg: a number (taken as exact) or a mass.json.")]
Rec = Annotated[Path, typer.Argument(metavar="REC", help="A recording.")]


Balance = Annotated[
    Path, typer.Option("--balance", help="balance.json from calibrate, or a matrix in BALFIT's text layout.")
]
MaybeBalance = Annotated[
    Path | None,
    typer.Option("--balance", help="balance.json, for recordings of gauge outputs (rAF ...) instead of loads."),
]
Zero = Annotated[
    list[Path] | None,
    typer.Option("--zero", help="Recording with no wind before the run (may be given again), or 'none'."),
]


class ModelOnZero(StrEnum):
    """Whether the model hung on the balance while its zero was read."""

    AUTO = "auto"
    ON = "on"
    OFF = "off"


OnZero = Annotated[
    ModelOnZero,
    typer.Option("--model-on-zero", help="Whether --zero was read with the model on; auto asks the natural zeros."),
]
ZeroAfter = Annotated[
    list[Path] | None, typer.Option("--zero-after", help="The same after the run: the drift is taken off.")
]
Tare = Annotated[
    list[Path] | None,
    typer.Option("--tare", help="Wind-off recording, its loads taken off at the same pitch (may be given again)."),
]


class Model(StrEnum):
    """Which terms a balance matrix may have."""

    LINEAR = "linear"
    QUADRATIC = "quadratic"
    ABS = "abs"
    SIX_BY_27 = "27"
    SIX_BY_96 = "96"
    AUTO = "auto"


class LoadForm(StrEnum):
    """Which six loads are given."""

    DIRECT = "direct"
    FORCE = "force"
    MOMENT = "moment"


class Way(StrEnum):
    """Which way a balance matrix goes."""

    ITERATIVE = "iterative"
    NON_ITERATIVE = "non-iterative"


class Method(StrEnum):
    """How the force is worked out."""

    SMOOTHER = "smoother"
    PAPER = "paper"


def example(text: str) -> str:
    """Epilogue of a command's help."""
    return f"Example: {PROGRAM} {text}"
