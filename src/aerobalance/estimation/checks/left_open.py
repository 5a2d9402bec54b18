"""What a record leaves open: noise of a color, force that noise, a converter or a filter hide, and hum."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from aerobalance.estimation.checks.colored_noise import slow_noise_doubts
from aerobalance.estimation.checks.faint_force import hidden_force
from aerobalance.estimation.checks.mains_hum import (
    driven_lines,
    hidden_doubts,
    hidden_harmonics,
    hum_doubts,
    lines_within_load,
    unknown_lines,
)
from aerobalance.estimation.checks.model_error import as_noise, error_behind
from aerobalance.estimation.checks.narrow_power import narrow_power
from aerobalance.estimation.checks.resolution import resolution_doubt, rounding_error
from aerobalance.estimation.decoupled_record import DecoupledRecord
from aerobalance.estimation.error_sources import Contribution, Noise
from aerobalance.estimation.force_smoother import SmootherResult
from aerobalance.estimation.record import ComponentRecord
from aerobalance.estimation.signal_model import SignalModel
from aerobalance.estimation.spectra.line_noise import Hum
from aerobalance.estimation.statespace.kalman import FORCE
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import DOUBTED, SETTINGS, Doubt
from aerobalance.recording.noise import step_of
from aerobalance.recording.sensors import load_gain_left

FREQUENCIES: Final = 4097
"""Frequencies from zero to half the sampling rate at which a filter is looked at."""

NOISE_OR_FORCE: Final = "what may be force or noise"
"""Name of the error where a record does not tell far above the natural frequency which of them it shows."""

COUNTS: Final = 0.1
"""Rms of that over the rest of the uncertainty from which on it is counted."""

FILTER_MATTERS: Final = 0.5
"""What a filter takes off the force over its uncertainty, from which on it is worth a word."""


Found = tuple[list[Doubt], list[Contribution]]
"""What is told, and what is counted in the uncertainty."""


def left_open(
    record: ComponentRecord, signal: SignalModel, fit: SmootherResult, *, hum: Hum, errors: Sequence[Contribution]
) -> Iterator[Found]:
    """Return what the record leaves open of a force, as doubts and as errors of it.

    Parameters
    ----------
    record
        The component made ready.
    signal
        What the record is made of.
    fit
        The force.
    hum
        What was to be taken for hum.
    errors
        The errors that are known otherwise: what is small beside them is not told.
    """
    rest = float(np.sqrt(np.mean(np.sum([one.deviation**2 for one in errors], axis=0))))
    yield from _behind_filter(record, fit, rest=rest)
    yield from _of_noise(record, signal, fit, rest=rest)
    yield from _of_hum(record, signal, fit, hum=hum, rest=rest)


def _behind_filter(record: ComponentRecord, fit: SmootherResult, *, rest: float) -> Iterator[Found]:
    """What the filter of the load takes off the force that is not made up for."""
    name, smooth = record.dynamics.component, fit.states[:, FORCE]
    low_pass = record.recording.low_passed.get(name)
    if low_pass is None:
        return
    error = error_behind(smooth, fit.force - smooth, low_pass, own=record.dynamics, interval=record.interval)
    effect, period = float(np.sqrt(np.mean(error**2))), 1 / record.dynamics.natural_frequency
    noise = as_noise(error, name=f"{DOUBTED}filter gain", period=period, interval=record.interval)
    if effect < FILTER_MATTERS * rest:
        yield [], [noise]
        return
    frequency = np.linspace(0, 0.5 / record.interval, FREQUENCIES)
    whole = float(frequency[np.flatnonzero(load_gain_left(low_pass, frequency) > 1 - 1e-9)[-1]])
    unit = si_unit(name)
    text = (
        f"{name} was read behind a {low_pass}, which is undone in full up to {whole:.3g} Hz: beyond, its noise "
        "would be raised with it and pass for force. The force has power there, of which the filter takes off "
        f"{effect:.3g} {unit} rms; that is in the uncertainty"
    )
    advice = "record with a filter of a higher corner, above twice the highest frequency of the force"
    yield [Doubt("filter gain", name, text, advice, effect, unit)], [noise]


def _of_noise(record: ComponentRecord, signal: SignalModel, fit: SmootherResult, *, rest: float) -> Iterator[Found]:
    """Noise of a color, and force that noise or the step of a converter hide."""
    reading, learned, floor = signal.reading, signal.learned, signal.floor
    component, count = record.dynamics.component, reading.values.size
    unit = si_unit(component)
    for told, open_ in slow_noise_doubts(signal, component, unit=unit):
        yield [told] if told else [], [open_] if open_ else []
    if floor is not None and floor.missing > COUNTS * rest:
        told = floor.doubt(component, unit=unit) if floor.missing > SETTINGS.doubtful * rest else None
        missing = np.full(count, floor.missing)
        yield [told] if told else [], [Noise(NOISE_OR_FORCE, component, missing, floor.density)]
    modes = record.coupled.modes if isinstance(record, DecoupledRecord) else record.dynamics.modes
    for narrow in narrow_power(fit, modes):
        if narrow.missing > COUNTS * rest:
            told = narrow.doubt(component, unit=unit) if narrow.missing > SETTINGS.doubtful * rest else None
            yield [told] if told else [], [narrow.error(component, count=count)]
    hidden = hidden_force(reading, learned, left=fit.residuals)
    if hidden is not None:
        told = hidden.doubt(component, unit=unit)
        yield [told] if told else [], [hidden.error(component, count=count, interval=reading.interval)]
    step = step_of(record.load)
    error = rounding_error(reading, learned, step=step) if step else None
    if error is not None:
        told = resolution_doubt(component, error, step=step, rest=rest, unit=unit)
        yield [told] if told else [], [error]


def _of_hum(
    record: ComponentRecord, signal: SignalModel, fit: SmootherResult, *, hum: Hum, rest: float
) -> Iterator[Found]:
    """Hum that may be force, force that may be hum, and hum that a load hides."""
    reading, learned = signal.reading, signal.learned
    component, count, interval = record.dynamics.component, reading.values.size, reading.interval
    unit = si_unit(component)
    left = np.where(reading.present, reading.filled - fit.columns @ fit.sizes, 0.0)
    if hum != "keep" and not driven_lines(record, signal.large):
        for doubt, noise in hum_doubts(
            reading,
            learned,
            left,
            named=() if isinstance(hum, str) else hum,
            large=unknown_lines(record, signal.large),
            of_load=signal.of_load,
            unit=unit,
        ):
            yield [doubt], [noise]
    if hum == "mains" and record.noise is None:
        lines = fit.sized(signal.hum)
        for doubt, noise in lines_within_load(reading, learned, lines=lines, unit=unit):
            yield [doubt], [noise]
        told, hidden = hidden_doubts(
            component,
            hidden_harmonics(reading, learned, left, lines=lines, of_load=signal.of_load),
            rest=rest,
            count=count,
            interval=interval,
            unit=unit,
        )
        yield [told] if told else [], [*hidden]
