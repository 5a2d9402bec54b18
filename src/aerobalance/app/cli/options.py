"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple, cast, get_type_hints

import typer

from aerobalance.app.cli.streams import given, given_all, wanted

if TYPE_CHECKING:
    from aerobalance.app.commands.balance_files import BalanceFiles


PROGRAM: Final = "aerobalance"


def capital(name: str | None) -> str | None:
    """Return the name of a component in the capitals that it is written with."""
    if name is None:
        return None
    return "all" if name.lower() == "all" else name.upper()


Json = Annotated[bool, typer.Option("--json", help="Print the result as one JSON object on standard output.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print all of the result after the short answer.")]
Replace = Annotated[
    bool, typer.Option("--replace", help="Replace a file that exists even if it is no earlier result of this kind.")
]
Out = Annotated[
    Path | None,
    typer.Option("-o", "--out", callback=wanted(".json"), help="Where to write the result; - is standard output."),
]
PageOut = Annotated[
    Path | None,
    typer.Option("-o", "--out", callback=wanted(".html"), help="Where to write the page; - is standard output."),
]
MapOut = Annotated[
    Path | None,
    typer.Option("-o", "--out", callback=wanted(".toml"), help="Where to write the map; on the screen if left out."),
]
NeededOut = Annotated[
    Path,
    typer.Option(
        "-o",
        "--out",
        callback=wanted(".csv"),
        help="Where to write the result; the ending chooses the format, - is CSV on standard output.",
    ),
]
Modes = Annotated[str, typer.Option("--modes", help="How many modes: a number, or auto for those the data show.")]
Component = Annotated[
    str, typer.Option("--component", callback=capital, help="Which component: NF, PM, SF, YM, RM or AF.")
]
Gravity = Annotated[float, typer.Option("--gravity", help="Local acceleration of gravity in m/s^2.", min=9.7, max=9.9)]
Map = Annotated[
    Path | None,
    typer.Option("--map", callback=given, help="Channel map (TOML) that says what a foreign file's columns are."),
]
Maps = Annotated[
    list[Path] | None,
    typer.Option(
        "--map",
        callback=given_all,
        help="Channel map (TOML) that says what a foreign file's columns are; of several files one, or one each.",
    ),
]
Mass = Annotated[str, typer.Option("--mass", help="Moving mass in kg: a number (taken as exact) or a mass.json.")]
Rec = Annotated[Path, typer.Argument(metavar="REC", callback=given, help="A recording; - is standard input.")]
ToRead = Annotated[Path, typer.Argument(metavar="FILE", callback=given, help="A recording; - is standard input.")]


Balance = Annotated[
    Path, typer.Option("--balance", help="balance.json from calibrate, or a matrix in BALFIT's text layout.")
]
MaybeBalance = Annotated[
    Path | None,
    typer.Option("--balance", help="balance.json, for recordings of gauge outputs (rAF ...) instead of loads."),
]
Zero = Annotated[
    list[Path] | None,
    typer.Option(
        "--zero", metavar="<path>", help="Recording with no wind before the run (may be given again), or 'none'."
    ),
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
    list[Path] | None,
    typer.Option("--zero-after", metavar="<path>", help="The same after the run: the drift is taken off."),
]
Tare = Annotated[
    list[Path] | None,
    typer.Option(
        "--tare",
        metavar="<path>",
        help="Wind-off recording, its loads taken off at the same pitch (may be given again).",
    ),
]


class Gauges(NamedTuple):
    """What gauge outputs are reduced with; a bundle of options."""

    balance: MaybeBalance = None
    zero: Zero = None
    model_on_zero: OnZero = ModelOnZero.AUTO
    zero_after: ZeroAfter = None
    tare: Tare = None

    @property
    def files(self) -> BalanceFiles | None:
        """The files, checked; None for a recording of loads."""
        return gauge_files(*self)


def bundled(command: Callable[..., None]) -> Callable[..., None]:
    """Return the command with the options of a bundle in the place of each parameter that is one.

    A bundle is a named tuple of annotated options. So options that many commands have are declared once, and arrive
    together.
    """
    hints = get_type_hints(command, include_extras=True)
    bundles: dict[str, type[tuple[Any, ...]]] = {}
    parameters: list[Parameter] = []
    for name, parameter in signature(command).parameters.items():
        kind = hints[name]
        if isinstance(kind, type) and issubclass(kind, tuple):
            bundles[name] = kind
            own, defaults = get_type_hints(kind, include_extras=True), cast("Any", kind)._field_defaults
            parameters += [
                Parameter(field, Parameter.KEYWORD_ONLY, default=defaults[field], annotation=own[field])
                for field in defaults
            ]
        else:
            parameters.append(parameter.replace(kind=Parameter.KEYWORD_ONLY, annotation=kind))

    @wraps(command)
    def run(**given: Any) -> None:
        for name, kind in bundles.items():
            given[name] = kind(*[given.pop(field) for field in cast("Any", kind)._fields])
        command(**given)

    run.__annotations__ = {one.name: one.annotation for one in parameters} | {"return": None}
    cast("Any", run).__signature__ = Signature(parameters)
    return run


class TermModel(StrEnum):
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


def gauge_files(
    balance: Path | None,
    zero: list[Path] | None,
    model_on_zero: ModelOnZero,
    zero_after: list[Path] | None,
    tare: list[Path] | None,
) -> BalanceFiles | None:
    """Files that gauge outputs are reduced with; None for a recording of loads, to which none of them apply.

    Raises
    ------
    ValueError
        They do not go together.
    """
    from aerobalance.app.commands.balance_files import BalanceFiles

    if balance is not None:
        return BalanceFiles.of(balance, zero=zero, model_on_zero=model_on_zero.value, zero_after=zero_after, tare=tare)
    if zero or zero_after or tare or model_on_zero != ModelOnZero.AUTO:
        raise ValueError(
            "--zero, --zero-after, --tare and --model-on-zero go with --balance: they are of gauge outputs"
        )
    return None
