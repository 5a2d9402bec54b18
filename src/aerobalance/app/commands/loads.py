"""The command loads, and the loads that force and compare begin with where gauge outputs were recorded."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from aerobalance.app.commands.answers import rounded, short
from aerobalance.app.commands.balance_files import BalanceFiles
from aerobalance.app.commands.shared import (
    Result,
    check_out,
    collected_warnings,
    opened,
    recording_of,
    table_text,
)
from aerobalance.balance.inversion import TOLERANCE
from aerobalance.balance.load_checks import beyond_range
from aerobalance.balance.load_formats import Form
from aerobalance.balance.loads import Loads
from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.estimation.working_record import beside_pieces
from aerobalance.io import check_output
from aerobalance.io.balance_file import read_matrix, write_balance
from aerobalance.io.balfit_matrix import write_balfit_matrix
from aerobalance.io.kinds import TABLE
from aerobalance.io.results_file import load_columns, writing
from aerobalance.recording.channel import Array
from aerobalance.recording.decimation import ends_between_samples
from aerobalance.recording.errors import FitError
from aerobalance.recording.part_warnings import PartWarnings
from aerobalance.recording.parts import Part, parts_of
from aerobalance.recording.progress import PROGRESS
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import corrected
from aerobalance.recording.side_by_side import Ahead

PART: Final = 1 << 16
"""Samples of a recording whose loads are worked out at once, 1.5 kB each for six components."""

MARGIN: Final = 1 << 12
"""Samples beside them that what sensors do is undone with, at least; a filter that remembers longer has more."""


def convert_matrix(path: Path, out: Path) -> Result:
    """Write a matrix in the other layout: balance.json as BALFIT's text, or that as balance.json."""
    check_out(out, path, kind="balance" if out.suffix.lower() == ".json" else "")
    with collected_warnings() as collected:
        matrix = read_matrix(path)
    if out.suffix.lower() == ".json":
        write_balance(out, matrix, found={}, inputs=[path], warnings=collected)
    else:
        write_balfit_matrix(out, matrix, description=f"from {path.name}")
    names = list(matrix.components)
    said = f"{path.name}: balance matrix of {', '.join(names)}\n"
    return {"file": path.name, "written": out.name, "components": names, "warnings": collected, "summary": said}


ENOUGH: Final = 1 << 12
"""Samples of a part from which the uncertainty of its loads by the calibration is summed up."""


class LoadSource(NamedTuple):
    """How a file becomes balance loads.

    Attributes
    ----------
    known
        The dynamics, whose mass carries the weight.
    files
        The balance with its zeros and tares; None where recordings hold loads already.
    gravity
        Local acceleration of gravity [m/s^2].
    channel_map
        Channel map of foreign files.
    """

    known: BalanceDynamics
    files: BalanceFiles | None
    gravity: float
    channel_map: Path | None

    @property
    def paths(self) -> tuple[Path, ...]:
        """All files that take part beside the recordings."""
        balance = () if self.files is None else self.files.paths
        return balance if self.channel_map is None else (*balance, self.channel_map)

    def read(self, path: Path) -> Recording | Loads:
        """Read a recording; gauge outputs become balance loads."""
        return self.reduction()(recording_of(path, self.channel_map))

    def reduction(self) -> Callable[[Recording | Loads], Recording | Loads]:
        """Read the balance's files; what is returned makes loads of gauge outputs, and leaves loads as they are."""
        if self.files is None:
            return lambda given: given
        reduce = self.files.reduction(model=self.known, gravity=self.gravity, channel_map=self.channel_map)
        return lambda given: given if isinstance(given, Loads) else reduce(given)


def loads(
    path: Path, out: Path, *, files: BalanceFiles, form: Form | None = None, channel_map: Path | None = None
) -> Result:
    """Balance loads, from the gauge outputs of a recording."""
    check_output(out)
    check_out(out, path, channel_map, *files.paths, kind=TABLE)
    found = LoadsSummary()
    with collected_warnings() as collected, opened(path, channel_map) as record:
        reduce = files.reduction(form=form, channel_map=channel_map)
        parts, beside = parts_of(record.samples, length=PART, margin=MARGIN), beside_pieces(record)
        told = PartWarnings(record)

        def reduced(part: Part) -> tuple[Recording, Loads]:
            begin, end = max(part.begin - beside, 0), min(part.end + beside, record.samples)
            recording = corrected(record.part(begin, end)).part(part.begin - begin, part.end - begin)
            return recording, reduce(recording)

        with writing(out, samples=record.samples, epoch=record.epoch) as append, Ahead(reduced, parts) as ahead:
            for place, part in enumerate(PROGRESS.each(parts, "part")):
                with told.of(part):
                    recording, felt = ahead.result(place)
                ahead.begin(place + 1)
                own = slice(part.first - part.begin, part.stop - part.begin)
                append(load_columns(out, recording, own, felt))
                found.add(felt, own)
            if not found.known:
                raise FitError(
                    f"{record.name}: no sample gives loads; each lacks a gauge output or has no solution. "
                    "Check units, zeros and the order of the bridges"
                )
        told.tell()
    result: Result = {"file": path.name, "written": out.name, **found.result(), "warnings": collected}
    return {**result, "summary": summary(result)}


def summary(result: Result) -> str:
    """Short answer for people: the loads, and what there is to say of zero, range and missing samples."""
    rows = []
    for name, found in result["components"].items():
        u = found["u_calibration_rms"]
        means = (rounded(found[key], u)[0] for key in ("mean", "least", "largest", "rms_about_mean"))
        rows.append((f"{name} [{found['unit']}]", *means, rounded(u, u)[1], short(found["noise_of_reading"], 2)))
    title = f"{result['file']}: balance loads; u is the standard uncertainty by the calibration"
    lines = [table_text(title, ("", "mean", "least", "largest", "rms about mean", "u", "noise"), rows)]
    lines.append(f"zero: {result['zero']['from']}")
    if result["missing"]:
        lines.append(f"{result['missing']} samples are missing")
    beyond = ", ".join(f"{name} {count}" for name, count in result["beyond_calibrated_range"].items() if count)
    if beyond:
        lines.append(f"samples beyond the calibrated range: {beyond}")
    return "\n".join(lines) + "\n"


def loads_result(felt: Loads) -> Result:
    """Plain data on balance loads."""
    found = LoadsSummary()
    found.add(felt, slice(0, felt.values.shape[0]))
    return found.result()


@dataclass(slots=True, eq=False)
class LoadsSummary:
    """What sums up balance loads, part by part."""

    _felt: Loads | None = None
    _count: Array = field(default_factory=lambda: np.zeros(0))
    _level: Array = field(default_factory=lambda: np.zeros(0))
    _sums: Array = field(default_factory=lambda: np.zeros((4, 0)))
    _ends: Array = field(default_factory=lambda: np.zeros((2, 0)))
    _missing: int = 0
    _beyond: Counter[str] = field(default_factory=Counter)
    _contraction: float = 0.0

    def add(self, felt: Loads, own: slice, *, every: int = 1) -> None:
        """Add those samples of a part that it answers for, each of which was made of so many of the record."""
        values = felt.values[own]
        # an uncertainty that changes with the load alone: of a long part some thousand samples have its mean square
        calibration = felt.part(own.start, own.stop).sparse(max(values.shape[0] // ENOUGH, 1)).calibration
        known = np.isfinite(values)
        filled = np.where(known, values, 0.0)
        count = known.sum(axis=0)
        if self._felt is None:
            self._felt = felt.part(0, 1)
            self._sums = np.zeros((4, values.shape[1]))
            self._ends = np.array([np.full(values.shape[1], np.inf), np.full(values.shape[1], -np.inf)])
            self._count = np.zeros(values.shape[1])
        if not self.known:
            self._level = filled.sum(axis=0) / np.maximum(count, 1)
        change = np.where(known, values - self._level, 0.0)
        self._count += count
        self._sums += [
            change.sum(axis=0),
            (change**2).sum(axis=0),
            np.nansum(calibration**2, axis=0) * (values.shape[0] / max(calibration.shape[0], 1)),
            count * every * felt.noise**2,
        ]
        if every > 1:  # the largest lie between the samples of a slower clock
            least, largest = np.array([ends_between_samples(column, every) for column in values.T]).T
        else:
            least, largest = np.nanmin(values, axis=0, initial=np.inf), np.nanmax(values, axis=0, initial=-np.inf)
        self._ends = np.array([np.minimum(self._ends[0], least), np.maximum(self._ends[1], largest)])
        self._missing += int(np.count_nonzero(~known.all(axis=1)))
        self._beyond.update(beyond_range(felt.balance, felt.native[own]))
        self._contraction = max(self._contraction, felt.contraction)

    @property
    def known(self) -> bool:
        """Whether any sample has loads."""
        return bool(self._count.any())

    def result(self) -> Result:
        """Plain data.

        Raises
        ------
        ValueError
            There was no part.
        """
        felt = self._felt
        if felt is None:
            raise ValueError("loads of no samples cannot be summed up")
        count = np.maximum(self._count, 1)
        shift = self._sums[0] / count
        rows = {
            "mean": self._level + shift,
            "least": self._ends[0],
            "largest": self._ends[1],
            "rms_about_mean": np.sqrt(np.maximum(self._sums[1] / count - shift**2, 0.0)),
            "noise_of_reading": np.sqrt(self._sums[3] / count),
            "u_calibration_rms": np.sqrt(self._sums[2] / count),
        }
        return {
            "components": {
                name: {"unit": felt.units[i], **{key: float(row[i]) for key, row in rows.items()}}
                for i, name in enumerate(felt.components)
            },
            "zero": {
                "from": felt.zero.source,
                "outputs": dict(zip(felt.balance.gauges, felt.zero.values.tolist(), strict=True)),
                "drift": dict(zip(felt.balance.gauges, felt.zero.drift.tolist(), strict=True)),
                "unit": "mV/V",
            },
            "missing": self._missing,
            "beyond_calibrated_range": {
                name: self._beyond[name] for name in felt.balance.components if self._beyond[name]
            },
            "iteration": {"tolerance_of_capacity": TOLERANCE, "contraction": self._contraction},
        }
