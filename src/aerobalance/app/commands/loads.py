"""The command loads, and the loads that weigh, force and compare begin with where gauge outputs were recorded."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple, Protocol

import numpy as np

from aerobalance.app.commands.answers import rounded, short
from aerobalance.app.commands.balance_files import (
    FORCES,
    BalanceFiles,
    Carried,
    attitudes_of,
    stand_in,
    zero_of,
    zeros_before,
)
from aerobalance.app.commands.known import Known
from aerobalance.app.commands.shared import Account, check_out, doubts, recording_of, table_text
from aerobalance.balance.load_formats import Form
from aerobalance.balance.loads import LoadsFelt, loads_felt, smooth_variance, wind_off_loads, with_loads
from aerobalance.balance.matrix import TOLERANCE, BalanceMatrix
from aerobalance.balance.weighing import LoadPoints, Weighing, points_from_recordings, weigh
from aerobalance.balance.zeros import CLEARLY, GaugeZero
from aerobalance.io import check_output, write_loads
from aerobalance.io.balance_file import write_balance
from aerobalance.io.balfit_matrix import write_balfit_matrix
from aerobalance.io.kinds import TABLE
from aerobalance.io.mass_file import read_weighing
from aerobalance.io.matrix_file import read_matrix
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY
from aerobalance.recording.errors import DataQualityWarning, FitError, warn_quality
from aerobalance.recording.gravity import PullOnZero, gravity_share
from aerobalance.recording.recording import Recording

SETTLED: Final = 1e-9
"""Change of a zero from round to round, over the outputs at full load, at which the weight in it is settled."""

MOST_ROUNDS: Final = 20
"""Rounds of weighing after which what is left is taken as it is: a round leaves some percent of the last change."""


def convert_matrix(path: Path, out: Path) -> Account:
    """Write a matrix in the other layout: balance.json as BALFIT's text, or that as balance.json."""
    check_out(out, path, kind="balance" if out.suffix.lower() == ".json" else "")
    with doubts() as collected:
        matrix = read_matrix(path)
    if out.suffix.lower() == ".json":
        write_balance(out, matrix, found={}, inputs=[path], warnings=collected)
    else:
        write_balfit_matrix(out, matrix, description=f"from {path.name}")
    names = list(matrix.components)
    said = f"{path.name}: balance matrix of {', '.join(names)}\n"
    return {"file": path.name, "written": out.name, "components": names, "warnings": collected, "summary": said}


def reduced(
    recording: Recording,
    files: BalanceFiles,
    *,
    form: Form | None = None,
    channel_map: Path | None = None,
    on_zero: Callable[[Sequence[Recording]], Carried] | None = None,
) -> tuple[LoadsFelt, BalanceMatrix]:
    """Loads felt in a recording, with zeros and tares from their files.

    `on_zero` gives the weight that hung on the balance while its zero was read: taken out of the zero, it stays in
    the loads, and curved bridges are read from where they were calibrated.
    """
    if files.tare and files.mass is not None:
        raise ValueError("give --tare or --mass, not both: each takes the weight off")
    matrix = read_matrix(files.balance)
    if matrix.direct is None and not set(matrix.components) <= set(COMPONENTS):
        warn_quality(
            f"{files.balance.name} lacks the distances of the gauges: the loads stay {', '.join(matrix.components)}. "
            "Calibrate with --distances to have NF PM SF YM RM AF"
        )
    before = zeros_before(files, channel_map)
    zero = zero_of(files, before, matrix, channel_map, on_zero=on_zero)
    if form not in (None, "direct") and files.mass is not None:
        raise ValueError(
            f"--form {form} cannot go with --mass, whose weight is known in direct-read form; give wind-off "
            "recordings with --tare instead, or leave --form out"
        )
    tare = None
    if files.tare:
        wind_off = [recording_of(path, channel_map) for path in files.tare]
        zero = stand_in(zero, wind_off, matrix)
        tare = wind_off_loads(recording, wind_off, matrix, zero=zero, form=form)
    elif files.mass is not None:
        tare = _weight(recording, files.mass, matrix, since=before if zero is not None and zero.weight.any() else ())
    return loads_felt(recording, matrix, zero=zero, tare=tare, form=form), matrix


class Hung(Protocol):
    """What hangs on a balance: of dynamics of either kind, or of a weighing."""

    @property
    def components(self) -> tuple[str, ...]:
        """Components that its weight is known along."""

    def weight(self, name: str, *, pitch: Array, roll: Array, gravity: float) -> Array:
        """Weight along a component at given attitudes, shape (n,) [N, N*m]."""


@dataclass(frozen=True, slots=True)
class Hanging:
    """What a weighing says that hangs on the balance.

    Attributes
    ----------
    weighing
        The weighing; None where nothing is known.
    """

    weighing: Weighing | None

    @property
    def components(self) -> tuple[str, ...]:
        """Components that it was weighed along."""
        return () if self.weighing is None else self.weighing.components

    def weight(self, name: str, *, pitch: Array, roll: Array, gravity: float) -> Array:
        """Weight along one of them; gravity is that of the weighing, whatever is said."""
        if self.weighing is None:
            raise ValueError(f"the weight along {name} is not known")
        loads = self.weighing.loads(pitch=pitch, roll=roll, offsets=False)
        return np.asarray(loads[:, self.weighing.components.index(name)])


class Reduction(NamedTuple):
    """Loads felt, and the balance matrix that they were worked out with."""

    felt: LoadsFelt
    matrix: BalanceMatrix


def from_gauges(
    recording: Recording,
    files: BalanceFiles,
    known: Hung,
    *,
    gravity: float,
    channel_map: Path | None,
) -> tuple[Recording, Reduction]:
    """Put loads in the place of gauge outputs, with gravity counted once: ready for the dynamics.

    Parameters
    ----------
    recording
        Gauge outputs, and what else is recorded.
    files
        The balance and its zeros and tares.
    known
        The dynamics, whose mass carries the weight, or what else hangs on the balance.
    gravity
        Local acceleration of gravity [m/s^2].
    channel_map
        Channel map of foreign files.

    Raises
    ------
    ValueError
        The weight would be taken off twice.
    FitError
        The recordings do not go together.
    """
    if files.mass is not None:
        raise ValueError("the weight comes from the mass in the dynamics; --mass would take it off twice")

    carried = partial(_carried_on_zero, known=known, gravity=gravity, pitched="pitch" in recording)
    felt, matrix = reduced(recording, files, channel_map=channel_map, on_zero=None if files.tare else carried)
    if "pitch" not in recording and not any(channel.coupling == "dc" for channel in recording):
        felt = _from_its_zero(felt)
    ready = with_loads(recording, felt)
    return (_without_gravity(ready) if files.tare else ready), Reduction(felt, matrix)


def _from_its_zero(felt: LoadsFelt) -> LoadsFelt:
    """Loads less the weight in their zero, for a run of no known attitude: it is taken for that of the zero."""
    zero = felt.zero
    own = [zero.weight[COMPONENTS.index(name)] if name in COMPONENTS else 0.0 for name in felt.components]
    counted = replace(zero, pull=PullOnZero())
    return replace(felt, values=felt.values - np.array(own), zero=counted)


class Source(NamedTuple):
    """How a file becomes loads felt.

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

    known: Known
    files: BalanceFiles | None
    gravity: float
    channel_map: Path | None

    @property
    def paths(self) -> tuple[Path, ...]:
        """All files that take part beside the recordings."""
        balance = () if self.files is None else self.files.paths
        return balance if self.channel_map is None else (*balance, self.channel_map)

    def recording(self, path: Path) -> tuple[Recording, Reduction | None]:
        """Read a file, and turn gauge outputs into loads felt."""
        recording = recording_of(path, self.channel_map)
        if self.files is None:
            return recording, None
        return from_gauges(recording, self.files, self.known, gravity=self.gravity, channel_map=self.channel_map)


def _without_gravity(recording: Recording) -> Recording:
    """Drop the angles: the wind-off loads that were taken off have the weight in them."""
    for channel in recording:
        if channel.coupling == "dc":
            raise FitError(
                f"{recording.name}: {channel.name} is dc-coupled and reads gravity, which --tare has taken off too;"
                " give the zero with --zero and leave the weight to the dynamics"
            )
    channels = {name: channel for name, channel in recording.channels.items() if name not in ("pitch", "roll")}
    return replace(recording, channels=channels)


def _carried_on_zero(zeros: Sequence[Recording], known: Hung, *, gravity: float, pitched: bool) -> Carried:
    """Weight of the moving mass on the balance while its zero was read."""
    lacking = [zero.name for zero in zeros if "pitch" not in zero] if pitched else []
    doubt = f"{lacking[0]} has no channel pitch; the zero is taken as read level, with the model on" if lacking else ""
    attitudes = [attitudes_of(zero) for zero in zeros]
    weights = np.zeros((len(zeros), len(COMPONENTS)))
    for row, (pitch, roll) in zip(weights, attitudes, strict=True):
        for name in known.components:
            row[COMPONENTS.index(name)] = np.nanmean(known.weight(name, pitch=pitch, roll=roll, gravity=gravity))
    pull = PullOnZero.of(attitudes, gravity=gravity)
    guess = _mass_of(known, gravity) * pull.acceleration
    return Carried(weights.mean(axis=0), pull, doubt, known.components, guess)


def _mass_of(known: Hung, gravity: float) -> float:
    """Mass by the first force that it is known along [kg], zero where it is by none."""
    oblique = np.array([np.pi / 4])  # all forces feel the weight there
    for name in FORCES:
        if name in known.components:
            share = gravity_share(name, pitch=oblique, roll=oblique)
            return float(known.weight(name, pitch=oblique, roll=oblique, gravity=gravity)[0] / (gravity * share[0]))
    return 0.0


def _weight(
    recording: Recording, path: Path, matrix: BalanceMatrix, *, since: Sequence[Recording] = ()
) -> tuple[Array, Array]:
    """Weight as the balance feels it at the attitude of a recording, and its standard uncertainty.

    `since` are the zeros of the run, read with the weight on: it counts from there.
    """
    weighing = read_weighing(path)
    names = matrix.components if matrix.direct is None else COMPONENTS
    recording.channel("pitch")  # without which the weight is not known
    pitch, roll = attitudes_of(recording)
    loads = weighing.loads(pitch=pitch, roll=roll, offsets=False)
    u = weighing.uncertainty(pitch=pitch, roll=roll, offsets=False, since=[attitudes_of(zero) for zero in since])
    columns = [weighing.components.index(name) if name in weighing.components else None for name in names]
    if all(column is None for column in columns):
        raise FitError(f"{path} weighs {', '.join(weighing.components)}, none of which are in {', '.join(names)}")
    nothing = np.zeros_like(pitch)
    return (
        np.column_stack([nothing if k is None else loads[:, k] for k in columns]),
        np.column_stack([nothing if k is None else u[:, k] for k in columns]),
    )


def weighed_loads(
    paths: Sequence[Path],
    files: BalanceFiles,
    *,
    gravity: float = STANDARD_GRAVITY,
    channel_map: Path | None = None,
    names: tuple[str, ...] | None = None,
) -> LoadPoints:
    """Static points of the loads felt, for weighing.

    Curved bridges read a load by what else hangs on them, so the weight that was on the balance while its zero was
    read is put back: that of a first weighing, then that of the next, until it changes no more.

    The error of the matrix is no noise: it goes with the load, so it can pass for a mass, an offset or a tilt. A
    smooth error of u over n points counts like noise of u sqrt(n) a point. Where neither the run nor the calibration
    has zeros, the mean of all recordings stands for them: weighing finds the offsets anyway, and only curved or
    bidirectional bridges care where their zero is.
    """
    if files.zero_after or files.tare or files.mass is not None:
        raise ValueError("weighing takes --zero alone: tares and closing zeros would take off what is weighed")
    recordings = [recording_of(path, channel_map) for path in paths]
    matrix = read_matrix(files.balance)
    before = zeros_before(files, channel_map)
    known = Hanging(None)
    if before and files.model_on_zero != "off":
        found = _settled(recordings, before, files, matrix, gravity=gravity, channel_map=channel_map)
        if found is None:
            warn_quality(
                f"{before[0].name} was read without what is weighed, as the offsets say: it is taken as read with the "
                "model off; --model-on-zero on or off says which"
            )
            files = replace(files, model_on_zero="off")
        else:
            known = found
    on_zero = partial(_carried_on_zero, known=known, gravity=gravity, pitched=True)
    zero = zero_of(files, before, matrix, channel_map, on_zero=on_zero)
    felt = _felt(recordings, matrix, zero)
    components = tuple(name for name in felt[0].components if name in COMPONENTS and (names is None or name in names))
    if not components:
        raise FitError(
            f"the balance has {', '.join(felt[0].components)}; weighing needs "
            f"{', '.join(names or COMPONENTS)}, for which the calibration lacks the gauges' distances"
        )
    points = _points(recordings, felt, components)
    smooth = np.sqrt(np.mean([smooth_variance(item, matrix) for item in felt], axis=0))
    own = smooth[[felt[0].components.index(name) for name in components]] * np.sqrt(len(points.pitch))
    return replace(points, noise=np.hypot(0.0 if points.noise is None else points.noise, own))


def _felt(recordings: Sequence[Recording], matrix: BalanceMatrix, zero: GaugeZero | None) -> list[LoadsFelt]:
    zero = stand_in(zero, recordings, matrix)
    return [loads_felt(recording, matrix, zero=zero) for recording in recordings]


def _points(recordings: Sequence[Recording], felt: Sequence[LoadsFelt], components: tuple[str, ...]) -> LoadPoints:
    return points_from_recordings(
        [with_loads(recording, item) for recording, item in zip(recordings, felt, strict=True)], components
    )


def _settled(
    recordings: Sequence[Recording],
    before: Sequence[Recording],
    files: BalanceFiles,
    matrix: BalanceMatrix,
    *,
    gravity: float,
    channel_map: Path | None,
) -> Hanging | None:
    """What hangs on the balance, by weighing with the weight of the weighing before in the zero; nothing if it fails.

    The weight changes sensitivities by some percent of themselves, so each round leaves some percent of the error of
    the one before. None where the first weighing says that nothing hung there while the zero was read.
    """
    known = Hanging(None)
    last = np.full(len(matrix.components), np.inf)
    scale = matrix.output_scale
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)  # what is doubtful is told of the last round
        for _ in range(MOST_ROUNDS):
            on_zero = partial(_carried_on_zero, known=known, gravity=gravity, pitched=True)
            zero = zero_of(files, before, matrix, channel_map, on_zero=on_zero)
            if zero is None or np.max(np.abs(zero.values - last) / scale) < SETTLED:
                break
            felt = _felt(recordings, matrix, zero)
            components = tuple(name for name in felt[0].components if name in COMPONENTS)
            try:
                known = Hanging(weigh(_points(recordings, felt, components), gravity=gravity))
            except (FitError, ValueError):
                return Hanging(None)
            if not np.isfinite(last).all() and files.model_on_zero == "auto" and _bare(known.weighing, before, matrix):
                return None
            last = zero.values
    return known


def _bare(weighing: Weighing | None, zeros: Sequence[Recording], matrix: BalanceMatrix) -> bool:
    """Whether offsets that were found with the zero as it was read are clearly those of a zero without the weight.

    Read under the weight, a zero leaves no load at its own attitude; without it, the weight. Natural zeros tell it
    better, where there are any.
    """
    if weighing is None or matrix.natural_zero is not None:
        return False
    attitudes = [attitudes_of(zero) for zero in zeros]
    weight, left, u = (
        np.mean([np.nanmean(table, axis=0) for table in tables], axis=0)
        for tables in (
            [weighing.loads(pitch=pitch, roll=roll, offsets=False) for pitch, roll in attitudes],
            [weighing.loads(pitch=pitch, roll=roll) for pitch, roll in attitudes],
            [weighing.uncertainty(pitch=pitch, roll=roll) for pitch, roll in attitudes],
        )
    )
    largest = int(np.argmax(np.abs(weight) * [name in FORCES for name in weighing.components]))
    return bool(left[largest] / weight[largest] > CLEARLY and u[largest] < CLEARLY / 2 * abs(weight[largest]))


def loads(
    path: Path, out: Path, *, files: BalanceFiles, form: Form | None = None, channel_map: Path | None = None
) -> Account:
    """Loads felt, from the gauge outputs of a recording."""
    check_output(out)
    check_out(out, path, channel_map, *files.paths, kind=TABLE)
    with doubts() as collected:
        recording = recording_of(path, channel_map)
        felt, matrix = reduced(recording, files, form=form, channel_map=channel_map)
    write_loads(out, recording, felt)
    account: Account = {"file": path.name, "written": out.name, **loads_account(felt, matrix), "warnings": collected}
    return {**account, "summary": summary(account)}


def summary(account: Account) -> str:
    """Short answer for people: the loads, and what there is to say of zero, range and missing samples."""
    rows = []
    for name, found in account["components"].items():
        u = found["u_calibration_rms"]
        means = (rounded(found[key], u)[0] for key in ("mean", "least", "largest", "rms_about_mean"))
        rows.append((f"{name} [{found['unit']}]", *means, rounded(u, u)[1], short(found["noise_of_reading"], 2)))
    title = f"{account['file']}: loads felt; u is the standard uncertainty by the calibration"
    lines = [table_text(title, ("", "mean", "least", "largest", "rms about mean", "u", "noise"), rows)]
    lines.append(f"zero: {account['zero']['from']}")
    if account["missing"]:
        lines.append(f"{account['missing']} samples are missing")
    beyond = ", ".join(f"{name} {count}" for name, count in account["beyond_calibrated_range"].items() if count)
    if beyond:
        lines.append(f"samples beyond the calibrated range: {beyond}")
    return "\n".join(lines) + "\n"


def loads_account(felt: LoadsFelt, matrix: BalanceMatrix) -> Account:
    """Plain data on loads felt."""
    return {
        "components": {
            name: {
                "unit": felt.units[i],
                "mean": float(np.nanmean(felt.values[:, i])),
                "least": float(np.nanmin(felt.values[:, i])),
                "largest": float(np.nanmax(felt.values[:, i])),
                "rms_about_mean": float(np.nanstd(felt.values[:, i])),
                "noise_of_reading": float(felt.noise[i]),
                "u_calibration_rms": float(np.sqrt(np.nanmean(felt.calibration[:, i] ** 2))),
            }
            for i, name in enumerate(felt.components)
        },
        "zero": {
            "from": felt.zero.source,
            "outputs": dict(zip(matrix.gauges, felt.zero.values.tolist(), strict=True)),
            "drift": dict(zip(matrix.gauges, felt.zero.drift.tolist(), strict=True)),
            "unit": "mV/V",
        },
        "missing": int(np.count_nonzero(~np.isfinite(felt.values).all(axis=1))),
        "beyond_calibrated_range": dict(felt.beyond),
        "iteration": {"tolerance_of_capacity": TOLERANCE, "contraction": felt.contraction},
    }
