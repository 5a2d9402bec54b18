"""What loads from gauge outputs are warned of about their zero: one that moves, differs, or was not taken off."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.zeros import MOVED_IN_RANGE, GaugeZero
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, si_unit
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import argument
from aerobalance.recording.linalg import whole_rows

AT_THEM: Final = 0.2
"""Distance of the mean outputs from the natural zeros, over these, up to which they lie at them."""

NOT_TAKEN_OFF: Final = 0.02
"""Load of the natural zeros over half of the calibrated range from which on it is told that they are in the loads."""


def doubts_of_zero(zero: GaugeZero, components: Sequence[str], slope: Array) -> Iterator[Doubt]:
    """What zeros say against loads that change with the gauge outputs by a slope, shape (c, c) [N V/mV]."""
    units = [si_unit(name) if name in COMPONENTS else "N" for name in components]
    known: list[tuple[Array, str, str]] = []
    if zero.moved.any():
        text = "moves while it is read, more than bridges drift, by {}: it is no zero, or the wind was on"
        known.append((np.abs(slope) @ zero.moved, text, "give a record of the balance at rest"))
    if zero.differ.any():
        text = "are zeros that differ by more than bridges drift; their mean is taken, which may be off by {}"
        known.append((np.abs(slope) @ zero.differ, text, "give the zero that belongs to the run"))
    if zero.drifted:
        text = (
            "and the zero after the run differ by more than bridges drift; it is taken as a steady change, and a jump "
            "leaves {}"
        )
        left = np.abs(slope @ zero.drift) / np.sqrt(12)  # rms of a jump in the middle of the run from a straight line
        known.append((left, text, "look for a contact, a loose part or a cable that moved"))
    for name, one in zero.from_natural.items():
        if one.of_range > MOVED_IN_RANGE[1] and name in components:
            unit = units[list(components).index(name)]
            yield Doubt(
                "zero",
                name,
                f"{zero.source} lies {abs(one.load):.3g} {unit} of {name} ({100 * one.of_range:.2g} % of range) from "
                "the natural zeros of the calibration, beyond the weight: it is of another day, the bridge has moved "
                "since the calibration, or what hung on the balance is not what is known of it",
                "take a zero anew just before the run, or weigh the model",
                None,
                unit,
            )
    for effects, text, advice in known:
        sizes = ", ".join(
            f"{size:.3g} {unit} of {name}" for size, unit, name in zip(effects, units, components, strict=True)
        )
        for name, unit, effect in zip(components, units, effects.tolist(), strict=True):
            yield Doubt("zero", name, f"{zero.source} {text.format(sizes)} (rms)", advice, effect, unit)


def doubts_of_no_zero(
    zero: GaugeZero, outputs: Array, balance: BalanceMatrix, components: Sequence[str], transform: Array
) -> Iterator[Doubt]:
    """What outputs say that are taken as less their zero, and read as they do with the zeros of the bridges in them.

    Parameters
    ----------
    zero
        The zero that is taken off.
    outputs
        The outputs as they were read, shape (n, c) [mV/V].
    balance
        The matrix.
    components, transform
        Components of the loads, k of them, and what makes them of the balance's own, shape (k, c).
    """
    natural = balance.natural_zero
    if natural is None or not zero.is_nothing:
        return
    known = outputs[whole_rows(outputs)]
    if not len(known):
        return
    mean, size = known.mean(axis=0), balance.output_scale
    if not np.linalg.norm((mean - natural) / size) < AT_THEM * np.linalg.norm(natural / size):
        return
    own = balance.loads(natural[None, :]).loads[0]
    of_range = np.abs(own) / (np.ptp(np.array(balance.calibrated), axis=0) / 2)
    if not (of_range > NOT_TAKEN_OFF).any():
        return
    effects = np.abs(transform @ np.nan_to_num(own))
    for name, effect in zip(components, effects.tolist(), strict=True):
        unit = si_unit(name) if name in COMPONENTS else "N"
        yield Doubt(
            "zero",
            name,
            "the gauge outputs are taken as less their zero already, and lie at the natural zeros of the calibration: "
            f"none was taken off, and what the bridges read without load, {effect:.3g} {unit} of {name}, is in the "
            "loads; or the mean loads of the run are just as large",
            f"give a recording without load as {argument('zero')}, or leave it out: then the natural zeros are taken",
            effect,
            unit,
        )
