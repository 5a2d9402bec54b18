"""What is assumed of a record and its balance because no record can show it, and what it would do to the force.

An analog filter before the load channel looks like another force. A gain that is wrong is wrong in everything. An
accelerometer that looks a degree aside reads a motion that nothing else shows. A natural frequency that is half a
percent off is seen where something rings, and not under a broad load in a short record; nor is the damping, to which
the flow adds its own. A converter that takes six bridges one after the other looks like other couplings.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.checks.colored_noise import noise_assumed
from aerobalance.estimation.checks.mains_hum import hum_assumed
from aerobalance.estimation.checks.model_error import error_under
from aerobalance.estimation.checks.narrow_power import interference_assumed
from aerobalance.estimation.checks.stretches import Stretches, passed_by
from aerobalance.estimation.decoupled_record import DecoupledRecord
from aerobalance.estimation.force_smoother import SmootherResult, instant_columns
from aerobalance.estimation.independent_record import SingleRecord, moves_along_axis
from aerobalance.estimation.least_squares import generalised_least_squares
from aerobalance.estimation.observation import Observation
from aerobalance.estimation.record import ComponentRecord, Through
from aerobalance.estimation.spectra.line_noise import Hum
from aerobalance.estimation.steps import response_to, shape_of
from aerobalance.motion.platform import SystematicParameter, driven_column
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import STANDARD_GRAVITY, si_unit
from aerobalance.recording.doubts import Assumption
from aerobalance.recording.errors import FitError, argument
from aerobalance.recording.gravity import Gravity
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import Transfer, filtered


@dataclass(frozen=True, slots=True)
class AssumptionSettings:
    """How far what is assumed may usually be off.

    Attributes
    ----------
    corner
        Corner of an anti-alias filter of second order over the sampling rate: as usual.
    gain
        Relative error of a gain [1].
    aside
        Angle by which an accelerometer looks aside [rad].
    frequency, damping
        Relative error of a natural frequency, and of a damping ratio [1].
    angle
        Error of the zero of an angle of the balance [rad].
    mass
        Relative error of a mass [1].
    apart
        Time between the readings of two bridges [s]: what converters that take one after the other wait to settle.
    late
        Time by which channels of the ground's motion may usually be late or early unnoticed [s].
    drift
        Change of the zero of a load from the beginning of a record to its end, over the largest load [1].
    matters
        Effect of an angle's zero, a drift, a natural frequency or damping ratio, or of gain, mass and time of coupled
        components, over the scatter of the force, from which it is told.
    told
        Its standard uncertainty by the record, over that, up to which the record tells it.
    steady
        The same of a natural frequency, up to which the record shows one that changes by so much halfway: half of it
        tells 1.4 times worse and is believed from a gain in log-likelihood of 10 on, which is 4.5 standard
        uncertainties, and what is learned of the force's spectrum takes half of what is told.
    first
        Samples of a record that are asked first whether they tell it.
    rounding
        Effect over the force that is no more than rounding.
    band
        Density of a force over its largest from which on it has power to show a natural frequency with.
    """

    corner: float = 0.4
    gain: float = 0.01
    aside: float = float(np.radians(1.0))
    frequency: float = 0.005
    damping: float = 0.2
    angle: float = float(np.radians(0.1))
    mass: float = 0.01
    apart: float = 1e-5
    late: float = 1e-3
    drift: float = 0.001
    matters: float = 0.1
    told: float = 0.5
    steady: float = 0.1
    first: int = 1 << 15
    rounding: float = 1e-9
    band: float = 1e-4


SETTINGS: Final = AssumptionSettings()
"""Sizes that are used."""


def assumptions_of(
    record: ComponentRecord, fit: SmootherResult, through: Through, *, hum: Hum
) -> Iterator[Assumption]:
    """Yield what is assumed for a force, each with what it would do to it.

    Parameters
    ----------
    record
        The component with its record.
    fit
        Its force by the smoother.
    through
        What the smoother makes of readings.
    hum
        What was to be taken for hum.
    """
    name, reading = record.dynamics.component, fit.reading
    unit = si_unit(name)

    def effect_of(change: Array) -> float:
        return float(np.sqrt(np.mean(through(np.where(reading.present, change, 0.0)[:, None])[:, 0] ** 2)))

    if name not in record.recording.declared:
        corner = SETTINGS.corner * record.recording.rate * record.recording.decimated
        change = filtered(reading.filled, _low_pass(corner), rate=record.recording.rate) - reading.filled
        text = (
            f"no analog filter or amplifier is declared for {name}: one of second order at {corner:.4g} Hz, "
            f"{SETTINGS.corner:g} of the rate, would change the force by {{}}"
        )
        late = float(np.sqrt(2)) / (2 * np.pi * corner)  # by so much it delays what is slow, and the steps
        at_steps = np.sum([step.height**2 for step in fit.steps]) * late / (fit.force.size * record.interval)
        yield _told("load filter", name, text, float(np.hypot(effect_of(change), np.sqrt(at_steps))), unit)
    shift = record.recording.zero_from_natural.get(name, 0.0)
    if shift:
        text = (
            f"the zero of {name} lies {abs(shift):.3g} {unit} from the natural zeros of the calibration, beyond the "
            "weight: all of that is taken for what the bridges moved since then"
        )
        yield Assumption("zero", name, text, abs(shift), unit)
    least = SETTINGS.matters * float(np.sqrt(np.mean(fit.variance)))
    yield from _of_zero(record.recording, fit, name, least=least)
    yield from _of_angles(record, unit, least=least)
    if moves_along_axis(record):
        if record.noise is None and fit.learned.color is None:
            yield from noise_assumed(fit.reading, fit.learned, name, unit=unit)
        if record.noise is None and hum == "mains" and not fit.reading.hum:
            yield from hum_assumed(fit.reading, fit.learned, unit=unit)
        yield from interference_assumed(fit, name, record.dynamics.modes, unit=unit)
        yield from _of_single(record, fit, unit)
    elif isinstance(record, DecoupledRecord):
        yield from _of_decoupled(record, fit.force, least=least)
        yield from _of_time(record, fit, least=least)
    across = record.motion_across
    if across is not None:
        slope, channel = across
        item = SystematicParameter("", "", SETTINGS.aside * slope, 0.0)
        text = (
            f"what moves across its axis is taken to be no part of {channel}: one degree aside, and a motion across "
            "as large as along it, would change the force by {}"
        )
        yield _told("cross-axis", name, text, effect_of(record.felt_under(item)), unit)


def _of_zero(recording: Recording, fit: SmootherResult, name: str, *, least: float) -> Iterator[Assumption]:
    """What is assumed of the zero that a load counts from; effects below `least` are not told."""
    unit, repeats = si_unit(name), recording.zero_repeats.get(name, 0.0)
    if repeats > least:
        text = (
            f"no zero was read after the run ({argument('Zero.after')}), so that what the bridges have moved by since "
            f"their zero was read is in {name}: as much as zeros of a balance repeat, 0.1 % of half of range, would "
            "change the force by {}"
        )
        yield _told("zero drift", name, text, repeats, unit)
    left = recording.zeros_left.get(name, 0.0)
    if left > least:
        text = (
            f"the gauge outputs are less their zero already ({argument('zero')}), so that none is taken off: with "
            f"zeros as those of the calibration still in them {name} would be off by {{}}"
        )
        yield _told("zero", name, text, left, unit)
    steady = SETTINGS.drift * float(np.max(np.abs(fit.reading.filled), initial=0.0)) / float(np.sqrt(3))
    if not recording.from_outputs and steady > least:
        text = (
            f"the zero of {name} stays as it is while the run is recorded: one that moves steadily, by "
            f"{100 * SETTINGS.drift:g} % of the largest load, would change the force by {{}}; a zero after the run "
            "shows it"
        )
        yield _told("zero drift", name, text, steady, unit)


def _of_angles(record: ComponentRecord, unit: str, *, least: float) -> Iterator[Assumption]:
    """What is assumed of the zeros of the angles, which tell the weight where no accelerometer reads gravity too.

    Run and zero at one attitude have the same error, so that none is left; effects below `least` are not told.
    """
    recording, name = record.recording, record.dynamics.component
    exact = [
        angle
        for angle in ("pitch", "roll")
        if angle in recording and not recording.channel(angle).zero_uncertainty > 0
    ]
    if not exact or any(channel.coupling == "dc" for channel in recording):
        return
    still = np.zeros(recording.samples)
    angles = {
        angle: np.nan_to_num(recording.channel(angle).values, nan=0.0) if angle in recording else still
        for angle in ("pitch", "roll")
    }
    slopes = Gravity.of(angles["pitch"], angles["roll"], gravity=STANDARD_GRAVITY).slopes
    for angle in exact:
        slope = slopes[angle] - recording.gravity_on_zero.slope(f"{angle} zero")
        single = moves_along_axis(record)
        item = SystematicParameter("", "", slope[:, driven_column(name)] if single else slope, 0.0)
        effect = SETTINGS.angle * float(np.sqrt(np.mean(record.as_force(item) ** 2)))
        if effect > least:
            text = f"the zero of {angle} is exact: {np.degrees(SETTINGS.angle):.1g} deg would change the force by {{}}"
            yield _told(f"{angle} zero", name, text, effect, unit)


def _of_gain(recording: Recording, channel: Channel, net: Array, *, least: float) -> Iterator[Assumption]:
    """What is assumed of the gain of a load, or of those of all bridges; effects up to `least` are not told.

    `net` is the force less what acts on the mass by motion and weight, since the zero of the load, shape (n,).
    """
    if channel.relative_uncertainty > 0 or recording.gains_stated:
        return
    effect = SETTINGS.gain * float(np.sqrt(np.mean(net**2)))
    if effect > least:
        whose = f"the gain of {channel.name} is"
        if recording.from_outputs:
            whose = "the gains of the bridges, their excitation and amplifiers, are those of the calibration and"
        text = f"{whose} exact: {100 * SETTINGS.gain:g} % would change the force by {{}}"
        yield _told("gain", channel.name, text, effect, si_unit(channel.name))


def _of_mass(mass: float, acting: Array, name: str, *, least: float) -> Iterator[Assumption]:
    """What is assumed of a mass that is taken for exact; effects up to `least` are not told.

    `acting` is what it is taken to do against the force by motion and weight, since the zero of the load, shape (n,).
    """
    effect = SETTINGS.mass * float(np.sqrt(np.mean(acting**2)))
    if effect > least:
        text = f"the mass of {mass:.6g} kg is exact: {100 * SETTINGS.mass:g} % would change the force by {{}}"
        yield _told("mass", name, text, effect, si_unit(name))


def _of_decoupled(record: DecoupledRecord, force: Array, *, least: float) -> Iterator[Assumption]:
    """What is assumed of the gains and of the mass of coupled components; effects up to `least` are not told."""
    name, mass = record.dynamics.component, record.coupled.mass
    acting = record.platform.specific_force + record.platform.gravity_on_zero
    acting = acting @ record.coupled.mass_rows[record.decoupled.place]
    yield from _of_gain(record.recording, record.channels[record.decoupled.place], force - acting, least=least)
    if mass is not None and mass.covariance[0, 0] == 0:
        yield from _of_mass(mass.mass, acting, name, least=least)


def _of_time(record: DecoupledRecord, fit: SmootherResult, *, least: float) -> Iterator[Assumption]:
    """What is assumed of when the bridges are read; effects up to `least` are not told.

    Readings that are late by d lack d times the slope of a load, which the inverse of the coupled balance takes for
    force. The smoother lets W = S G^2 / (S G^2 + N) of it through; a step shows in full, for as long as it is late.
    """
    if any(channel.delay for channel in record.channels):
        return
    count, interval, place = fit.force.size, record.interval, record.decoupled.place
    late = SETTINGS.apart * np.arange(len(record.channels))
    shown = Stretches.of(record.loads)
    frequency = shown.frequency(interval)
    lacking = 2j * np.pi * frequency[:, None] * late * record.coupled.inverse_response(frequency)[:, place]
    power = shown.power_of(np.einsum("kjm,mj->km", shown.lines, passed_by(fit, frequency)[:, None] * lacking))
    at_steps = np.sum([step.height**2 for step in fit.steps]) * float(late[place]) / (count * interval)
    effect = float(np.sqrt(power + at_steps))
    if effect > least:
        name = record.dynamics.component
        text = (
            f"all bridges are read at the same instants: read one after the other, {1e6 * SETTINGS.apart:g} us apart, "
            f"they would change {name} by {{}}; a delay of each channel says when"
        )
        yield _told("time of reading", name, text, effect, si_unit(name))


def _of_single(record: SingleRecord, fit: SmootherResult, unit: str) -> Iterator[Assumption]:
    """What is assumed of the gain of a load, of the mass, the natural frequency and the damping."""
    name, own = record.dynamics.component, record.dynamics
    acting = own.mass * (record.motion.specific_force + record.motion.gravity_on_zero)
    yield from _of_gain(record.recording, record.recording.channel(name), fit.force - acting, least=0.0)
    if own.uncertainty("mass") == 0:
        yield from _of_mass(own.mass, acting, name, least=0.0)
    off = f"{100 * SETTINGS.frequency:g} % more or less"
    yield from _of_dynamics(
        record,
        fit,
        own.retuned(frequency=1 + SETTINGS.frequency, damping=1.0),
        kind="natural frequency",
        stated=own.uncertainty("natural_frequency") / (SETTINGS.frequency * own.natural_frequency),
        text=f"the natural frequency of {name} is {own.natural_frequency:.5g} Hz, which this record does not tell: "
        f"{off} would change the force by {{}}",
        changing=f"the natural frequency of {name} is the same all along, of which this record tells the mean and no "
        f"more: {off} from halfway on would change the force by {{}}",
    )
    if own.damping_ratio > 0:
        yield from _of_dynamics(
            record,
            fit,
            own.retuned(frequency=1.0, damping=1 + SETTINGS.damping),
            kind="damping ratio",
            stated=own.uncertainty("damping_ratio") / (SETTINGS.damping * own.damping_ratio),
            text=f"the damping ratio of {name} is {own.damping_ratio:.3g}, which this record does not tell: "
            f"{100 * SETTINGS.damping:g} % more or less, as a flow may make it, would change the force by {{}}",
        )


def _of_dynamics(
    record: SingleRecord,
    fit: SmootherResult,
    other: Dynamics,
    *,
    kind: str,
    stated: float,
    text: str,
    changing: str | None = None,
) -> Iterator[Assumption]:
    """What is assumed of the dynamics, by others that are usual, unless the record tells them or an uncertainty does.

    `stated` is the standard uncertainty of what they are other in, over how far they are off [1]; `changing` is said
    where the record tells them as a whole and would not if they changed halfway.
    """
    if stated > SETTINGS.told:
        return
    least = SETTINGS.told if changing is None else SETTINGS.steady
    count = fit.force.size
    some = min(SETTINGS.first, count)
    told = _told_by(fit, other, some)  # most records tell it soon
    if told < SETTINGS.told:
        told *= float(np.sqrt(some / count))  # and what is told already, all of them better in proportion
    if told < least:
        return
    error = error_under(fit.force, own=record.dynamics, other=other, interval=record.interval)
    effect = float(np.sqrt(np.mean(error**2)))
    rounding = SETTINGS.rounding * float(np.sqrt(np.mean(fit.force**2)))
    if effect <= max(SETTINGS.matters * float(np.sqrt(np.mean(fit.variance))), rounding):
        return
    if told >= SETTINGS.told and count > some:
        told = _told_by(fit, other, count)
    name = record.dynamics.component
    if told >= SETTINGS.told:
        yield _told(kind, name, text, effect, si_unit(name))
    elif changing is not None and told >= least:
        effect = float(np.sqrt(np.sum(error[count // 2 :] ** 2) / count))
        yield _told(kind, name, changing, effect, si_unit(name))


def _told_by(fit: SmootherResult, other: Dynamics, count: int) -> float:
    """How well the first samples of a record tell its dynamics from others [1]; 0 where they cannot be asked.

    It is the standard uncertainty of how far they are others, 1 for those; infinite where nothing shows them.
    """
    reading = replace(fit.reading, values=fit.reading.values[:count])
    known = instant_columns(reading, fit.steps, heights=[step.height for step in fit.steps])[0]
    columns = np.column_stack([known, _shown_by(fit, reading, other)])
    try:
        _, covariance, _ = generalised_least_squares(fit.filter.over(reading.present), reading.filled, columns)
    except FitError:
        return 0.0
    return float(np.sqrt(covariance[-1, -1])) or np.inf


def _shown_by(fit: SmootherResult, reading: Observation, other: Dynamics) -> Array:
    """What the first readings show of it that the balance is another, shape (n,) [N]: by the steps, and by the force.

    The force has no power beyond its band: what the ends of the record leave of it there, at the natural frequency
    above all, would pass for knowledge of that.
    """
    count, there = reading.values.size, replace(reading, dynamics=other)
    staircase, shown = np.zeros(count), np.zeros(count)
    for step in fit.steps:
        staircase += step.height * shape_of(step, reading)
        shown += step.height * (response_to(step, there) - response_to(step, reading))
    frequency = np.asarray(np.fft.rfftfreq(2 * count, reading.interval), dtype=np.float64)
    density = fit.learned.spectrum.density(frequency)
    rest = fit.force[:count] - staircase
    lines = np.fft.rfft(np.concatenate([rest, rest[::-1]])) * (density > SETTINGS.band * density.max(initial=0.0))
    change = other.response(frequency) - reading.dynamics.response(frequency)
    return shown + np.fft.irfft(lines * change, 2 * count)[:count]


def _told(kind: str, component: str, text: str, effect: float, unit: str) -> Assumption:
    return Assumption(kind, component, text.format(f"{effect:.2g} {unit} rms"), effect, unit)


def _low_pass(corner: float) -> Transfer:
    """A Butterworth filter of second order."""

    def response(frequency: Array) -> NDArray[np.complex128]:
        x = frequency / corner
        return np.asarray(1 / (1 - x**2 + 1j * np.sqrt(2) * x), dtype=np.complex128)

    return response
