"""The files that go with gauge outputs: the balance matrix, and the zeros with what hung on the balance meanwhile."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final, Literal, NamedTuple

import numpy as np

from aerobalance.app.commands.shared import recording_of
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.zeros import (
    GaugeZero,
    beyond_weight,
    change_of_sensitivity,
    gauge_zero,
    in_own_components,
    reads_no_weight,
    seen_on_zero,
    without_weight,
)
from aerobalance.io.mass_file import read_weighing
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, si_unit
from aerobalance.recording.errors import FitError, warn_quality
from aerobalance.recording.gravity import Attitudes, PullOnZero
from aerobalance.recording.recording import Recording

ModelOnZero = Literal["auto", "on", "off"]


@dataclass(frozen=True, slots=True)
class BalanceFiles:
    """Files that gauge outputs are reduced with.

    Attributes
    ----------
    balance
        balance.json, or a matrix in BALFIT's text layout.
    zero, zero_after
        Recordings with no wind before and after the run; the word ``none`` takes outputs as they are.
    tare
        Wind-off recordings, whose loads are taken off at the same attitude.
    mass
        mass.json of a weighing, whose weight is taken off instead.
    model_on_zero
        Whether the model hung on the balance while the zero was read; ``auto`` takes it so unless the natural zeros of
        the calibration speak against it.
    """

    balance: Path
    zero: tuple[Path, ...] = ()
    zero_after: tuple[Path, ...] = ()
    tare: tuple[Path, ...] = ()
    mass: Path | None = None
    model_on_zero: ModelOnZero = "auto"

    @classmethod
    def of(
        cls,
        balance: Path,
        *,
        zero: list[Path] | None = None,
        model_on_zero: ModelOnZero = "auto",
        zero_after: list[Path] | None = None,
        tare: list[Path] | None = None,
        mass: Path | None = None,
    ) -> BalanceFiles:
        """Take the files as the command line gives them."""
        if model_on_zero != "auto" and not zero:
            raise ValueError(f"--model-on-zero {model_on_zero} is said of a zero; give its recordings with --zero")
        return cls(balance, tuple(zero or ()), tuple(zero_after or ()), tuple(tare or ()), mass, model_on_zero)

    @property
    def paths(self) -> tuple[Path, ...]:
        """All files."""
        zeros = () if self.as_they_are else self.zero
        return (self.balance, *zeros, *self.zero_after, *self.tare, *(() if self.mass is None else (self.mass,)))

    @property
    def as_they_are(self) -> bool:
        """Whether the outputs are already less their zero."""
        return [str(path) for path in self.zero] == ["none"]


FORCES: Final = tuple(name for name in COMPONENTS if si_unit(name) == "N")

CURVED: Final = 0.001
"""Change of sensitivities, as part of range, from which it is told that a weight on the zero is not known."""

USUAL_WEIGHT: Final = 0.3
"""Weight over range that a model may well have."""

_NOTHING: Final = np.zeros(len(COMPONENTS))


class Carried(NamedTuple):
    """What hung on the balance while its zero was read, along the components.

    Attributes
    ----------
    weight
        Shape (6,) [N, N*m].
    pull
        Pull of gravity on it.
    doubt
        What is doubtful about it, or nothing.
    known
        Components along which the weight is known.
    guess
        What it would be along the other forces if it were one mass at the balance's centre, shape (6,) [N, N*m].
    """

    weight: Array
    pull: PullOnZero
    doubt: str = ""
    known: tuple[str, ...] = COMPONENTS
    guess: Array = _NOTHING


def zeros_before(files: BalanceFiles, channel_map: Path | None) -> list[Recording]:
    """Recordings of the balance before the run."""
    return [] if files.as_they_are else [recording_of(path, channel_map) for path in files.zero]


def zero_of(
    files: BalanceFiles,
    before: Sequence[Recording],
    matrix: BalanceMatrix,
    channel_map: Path | None,
    *,
    on_zero: Callable[[Sequence[Recording]], Carried] | None = None,
) -> GaugeZero | None:
    """Zero of a run from the recordings before it and after it; None where there are none, and the weight taken out.

    Parameters
    ----------
    files
        The files.
    before
        Recordings before the run, as `zeros_before` gives them.
    matrix
        The balance matrix.
    channel_map
        Channel map of the recordings after it.
    on_zero
        Gives what hung on the balance meanwhile; None where that is not known, or a mass.json says it.
    """
    if files.as_they_are:
        nothing = np.zeros(len(matrix.components))
        return GaugeZero(nothing, nothing, "none: outputs as they are", nothing)
    if not before:
        if files.zero_after:
            raise ValueError("--zero-after needs --zero: the drift is what changes between the two")
        return None
    after = [recording_of(path, channel_map) for path in files.zero_after]
    zero = gauge_zero(before, matrix, after=after)
    if files.mass is not None:
        on_zero = partial(_weighed, mass=files.mass)
    if files.model_on_zero == "off":
        return zero
    carried = Carried(_NOTHING, PullOnZero(), known=()) if on_zero is None else on_zero(before)
    if files.model_on_zero == "auto" and reads_no_weight(zero, carried.weight, matrix):
        warn_quality(
            f"{zero.source} reads as the natural zeros of the calibration do, without the weight: it is taken as read "
            "with the model off; --model-on-zero on or off says which"
        )
        return zero
    if carried.doubt:
        warn_quality(carried.doubt)
    return without_weight(_under(zero, carried, matrix), matrix)


def _under(zero: GaugeZero, carried: Carried, matrix: BalanceMatrix) -> GaugeZero:
    """Zero with the loads it was read under: the weight that is known, and where curved bridges were beyond it."""
    point = beyond_weight(seen_on_zero(zero, matrix), carried.weight, carried.known, matrix)
    if matrix.natural_zero is None and not set(carried.known) >= set(FORCES):
        guessed = np.where([name in carried.known for name in COMPONENTS], carried.weight, carried.guess)
        point = beyond_weight(in_own_components(guessed, matrix), carried.weight, carried.known, matrix)
        _say_what_is_guessed(zero, point, carried, matrix)
    return replace(zero, weight=carried.weight, pull=carried.pull, operating_point=point if point.any() else None)


def _say_what_is_guessed(zero: GaugeZero, point: Array, carried: Carried, matrix: BalanceMatrix) -> None:
    """Warn where the weight on a zero is not known and bridges are so curved that it matters."""
    usual = np.diag(USUAL_WEIGHT * matrix.load_scale)
    change = max(change_of_sensitivity(share, matrix) for share in ([point] if point.any() else usual))
    if change < CURVED:
        return
    if point.any():
        others = ", ".join(name for name in FORCES if name not in carried.known)
        text = (
            f"{zero.source}: the weight along {others} while this zero was read is not known; that of the same mass "
            f"at the centre of the balance is taken. It changes sensitivities by up to {100 * change:.2g} % of range. "
            "Natural zeros in the calibration would tell it"
        )
    else:
        text = (
            f"{zero.source}: the weight that hung on the balance while this zero was read is not known, and the "
            f"bridges are curved: {100 * USUAL_WEIGHT:g} % of the range would change sensitivities by up to "
            f"{100 * change:.2g} % of range. Give the mass.json of a weighing of all loads (weigh without "
            "--component) with --mass, or say --model-on-zero off if there was none; natural zeros in the calibration "
            "tell it too"
        )
    warn_quality(text)


def stand_in(zero: GaugeZero | None, recordings: Sequence[Recording], matrix: BalanceMatrix) -> GaugeZero | None:
    """Take the mean of recordings at rest for a zero, where neither the run nor the calibration has one."""
    if zero is not None or matrix.natural_zero is not None:
        return zero
    warn_quality(
        "no zero was given and the calibration has none; the mean of the recordings at rest is taken for it. Offsets "
        "count from there, and curved or bidirectional bridges are read from there"
    )
    return gauge_zero(recordings, matrix)


def _weighed(recordings: Sequence[Recording], *, mass: Path) -> Carried:
    """Weight of a weighing at the attitudes of recordings, their mean."""
    lacking = [recording.name for recording in recordings if "pitch" not in recording]
    if lacking:
        raise FitError(
            f"{lacking[0]} has no channel pitch, so the weight in its zero is not known; record pitch with the zero, "
            "say --model-on-zero off if it was read without the model, or take wind-off recordings as --tare"
        )
    weighing = read_weighing(mass)
    attitudes = [attitudes_of(recording) for recording in recordings]
    loads = [weighing.loads(pitch=pitch, roll=roll, offsets=False) for pitch, roll in attitudes]
    weight = np.zeros(len(COMPONENTS))
    weight[[COMPONENTS.index(name) for name in weighing.components]] = np.mean(
        [np.nanmean(table, axis=0) for table in loads], axis=0
    )
    return Carried(weight, PullOnZero.of(attitudes, gravity=weighing.gravity), known=weighing.components)


def attitudes_of(recording: Recording) -> Attitudes:
    """Pitch and roll of a recording, zero where it has none, shape (n,) each."""
    nothing = np.zeros(recording.samples)
    pitch, roll = (recording.channel(name).values if name in recording else nothing for name in ("pitch", "roll"))
    return Attitudes(pitch, roll)
