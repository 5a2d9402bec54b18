"""The files that gauge outputs are reduced with: balance matrix, zeros, and wind-off recordings or a weighing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from aerobalance.app.commands.shared import recording_of
from aerobalance.balance.load_formats import Form
from aerobalance.balance.loads import Loads
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.reduction import OutputReduction
from aerobalance.balance.weighing import Weighing
from aerobalance.balance.zeros import CarriedWeight, Zero
from aerobalance.io.balance_file import read_matrix
from aerobalance.io.mass_file import read_weighing
from aerobalance.recording.components import STANDARD_GRAVITY
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

    def matrix(self) -> BalanceMatrix:
        """Read the balance matrix."""
        return read_matrix(self.balance)

    def zeros(self, channel_map: Path | None) -> Zero | None:
        """Read the zeros of the run; None where none are given."""
        if self.as_they_are:
            return Zero((), model_on=False)
        if not self.zero:
            if self.zero_after:
                raise ValueError("--zero-after needs --zero: the drift is what changes between the two")
            return None
        before, after = ([recording_of(path, channel_map) for path in paths] for paths in (self.zero, self.zero_after))
        said: bool | Literal["auto"] = "auto" if self.model_on_zero == "auto" else self.model_on_zero == "on"
        return Zero(before, model_on=said, after=after)

    def tares(self, channel_map: Path | None) -> list[Recording] | Weighing:
        """Read the wind-off recordings, or the weighing, that are taken off; an empty list where none are given."""
        if self.tare and self.mass is not None:
            raise ValueError("give --tare or --mass, not both: each takes the weight off")
        if self.mass is not None:
            return read_weighing(self.mass)
        return [recording_of(path, channel_map) for path in self.tare]

    def identification_loads(
        self,
        recordings: Sequence[Recording],
        weighing: Weighing | None,
        *,
        channel_map: Path | None,
        calibration_counts: bool = True,
    ) -> list[Loads]:
        """Read the files, and work out the balance loads of recordings that dynamics are to be identified from."""
        from aerobalance.identification.from_outputs import (  # noqa: PLC0415 - not for a force
            identification_loads,
        )

        tare = self.tares(channel_map)
        if isinstance(tare, Weighing):
            raise ValueError(  # noqa: TRY004 - two options that exclude each other
                "the weight comes from the mass in the dynamics; --mass would take it off twice"
            )
        return identification_loads(
            recordings,
            self.matrix(),
            zero=self.zeros(channel_map),
            tare=tare,
            weighing=weighing,
            calibration_counts=calibration_counts,
        )

    def reduction(
        self,
        *,
        model: CarriedWeight | None = None,
        gravity: float = STANDARD_GRAVITY,
        form: Form | None = None,
        channel_map: Path | None = None,
    ) -> Callable[[Recording], Loads]:
        """Read the files; what is returned works out the balance loads of a run or of a part of it.

        Arguments as `reduce_outputs` has them.
        """
        if model is not None and self.mass is not None:
            raise ValueError("the weight comes from the mass in the dynamics; --mass would take it off twice")
        if form not in (None, "direct") and self.mass is not None:
            raise ValueError(
                f"--form {form} cannot go with --mass, whose weight is known in direct-read form; give wind-off "
                "recordings with --tare instead, or leave --form out"
            )
        tare = self.tares(channel_map)
        matrix, zero = self.matrix(), self.zeros(channel_map)
        return OutputReduction(matrix, zero=zero, model=model, tare=tare, gravity=gravity, form=form).loads

    def loads(
        self,
        recording: Recording,
        *,
        model: CarriedWeight | None = None,
        gravity: float = STANDARD_GRAVITY,
        form: Form | None = None,
        channel_map: Path | None = None,
    ) -> Loads:
        """Read the files, and work out the balance loads of a run; arguments as `reduction` has them."""
        return self.reduction(model=model, gravity=gravity, form=form, channel_map=channel_map)(recording)
