"""The files that go with gauge outputs: the balance matrix, and the zeros with what hung on the balance meanwhile."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from aerobalance.balance import BalanceMatrix
from aerobalance.channel import Array
from aerobalance.commands.shared import recording_of
from aerobalance.components import COMPONENTS
from aerobalance.gravity import Attitudes, PullOnZero
from aerobalance.io.weighing_file import read_weighing
from aerobalance.problems import DoubtWarning, FitError
from aerobalance.recording import Recording
from aerobalance.zeros import GaugeZero, gauge_zero, reads_no_weight, without_weight

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
    """

    weight: Array
    pull: PullOnZero
    doubt: str = ""


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
    if files.model_on_zero == "off" or on_zero is None:
        return zero
    carried = on_zero(before)
    if files.model_on_zero == "auto" and reads_no_weight(zero, carried.weight, matrix):
        warnings.warn(
            f"{zero.source} reads as the natural zeros of the calibration do, without the weight: it is taken as read "
            "with the model off; --model-on-zero on or off says which",
            DoubtWarning,
            stacklevel=4,
        )
        return zero
    if carried.doubt:
        warnings.warn(carried.doubt, DoubtWarning, stacklevel=4)
    return without_weight(replace(zero, weight=carried.weight, pull=carried.pull), matrix)


def stand_in(zero: GaugeZero | None, recordings: Sequence[Recording], matrix: BalanceMatrix) -> GaugeZero | None:
    """Take the mean of recordings at rest for a zero, where neither the run nor the calibration has one."""
    if zero is not None or matrix.natural_zero is not None:
        return zero
    warnings.warn(
        "no zero was given and the calibration has none; the mean of the recordings at rest is taken for it. Offsets "
        "count from there, and curved or bidirectional bridges are read from there",
        DoubtWarning,
        stacklevel=3,
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
    return Carried(weight, PullOnZero.of(attitudes, gravity=weighing.gravity))


def attitudes_of(recording: Recording) -> Attitudes:
    """Pitch and roll of a recording, zero where it has none, shape (n,) each."""
    nothing = np.zeros(recording.samples)
    pitch, roll = (recording.channel(name).values if name in recording else nothing for name in ("pitch", "roll"))
    return Attitudes(pitch, roll)
