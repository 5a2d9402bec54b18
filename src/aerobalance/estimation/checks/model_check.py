"""What a record says against the dynamics that it is read with: a mode that they lack, a spring that has changed.

A record of a release is fitted as a free decay once more; in any other record the resonances of the reading's spectrum
are looked at. Neither needs the force.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from aerobalance.dynamics.modal import Mode
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.applied_force import Force
from aerobalance.estimation.checks.local_modes import Averaged, missing_mode, own_resonance
from aerobalance.estimation.checks.peaks import Peak, peak_sentences
from aerobalance.estimation.checks.release import release_in
from aerobalance.estimation.checks.unmeasured_rotation import turning_by_angles
from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.estimation.prior import Observation
from aerobalance.estimation.record import FEWEST_SAMPLES, ComponentRecord, SingleRecord
from aerobalance.estimation.spectra.line_noise import Line, reading_of_lines
from aerobalance.estimation.steps import Step, columns_of
from aerobalance.identification.free_decay.fit import DecayFit
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit
from aerobalance.recording.errors import argument
from aerobalance.recording.wording import frequency_text, share_text


@dataclass(frozen=True, slots=True)
class ModelCheckSettings:
    """Thresholds of the checks of dynamics against a record.

    Attributes
    ----------
    drift
        Standard uncertainties that frequency or damping has to be off before it is said to have changed.
    same_mode
        Relative difference of frequency up to which a mode in the record is one of the dynamics'.
    longest
        Samples from the start that are looked at: more tell nothing new.
    changed
        Gain in twice the log-likelihood that another frequency and damping must bring: chance has it once in 3
        million. The curvature at the optimum alone says too much of a resonance that the load hardly excites.
    least_damping
        Part of a known damping ratio below which only that it is smaller is said: so narrow a line is rather hum.
    """

    drift: float = 5.0
    same_mode: float = 0.02
    longest: int = 1 << 17
    changed: float = 30.0
    least_damping: float = 0.05


SETTINGS: Final = ModelCheckSettings()
"""Thresholds that are used."""


@dataclass(frozen=True, slots=True)
class Misfit:
    """What a record says against the dynamics of one component.

    Attributes
    ----------
    component
        Which component.
    missing
        A mode that the dynamics lack; None if none is seen.
    u_frequency, u_share
        Standard uncertainties of its frequency [Hz] and its share [1].
    size
        Root mean square, or for a release the amplitude, of its ringing in the balance load [N]; None where that would
        be more than the load itself has.
    frequency, damping
        Relative change of natural frequency and damping ratio of the first mode with its standard uncertainty [1];
        None where the record does not tell or nothing has changed.
    released
        True when a release tells, False when the spectrum does.
    """

    component: str
    missing: Mode | None = None
    u_frequency: float = 0.0
    u_share: float = 0.0
    size: float | None = None
    frequency: tuple[float, float] | None = None
    damping: tuple[float, float] | None = None
    released: bool = False

    def sentences(self, dynamics: Dynamics) -> list[str]:
        """What to tell the user, a sentence for each finding."""
        found, unit = [], si_unit(self.component)
        if self.missing is not None:
            mode = self.missing
            size = "" if self.size is None else f" with {self.size:.3g} {unit}{'' if self.released else ' rms'}"
            cause = (
                f"it rings after the release{size}"
                if self.released
                else f"it swings{size}; a narrow band of the load itself looks the same"
            )
            found.append(
                f"{self.component} shows a mode at {frequency_text(mode.natural_frequency, self.u_frequency)}, "
                f"{share_text(mode.share, self.u_share)}, that the dynamics lack: {cause}; forces near that "
                "frequency are wrong until it is identified, from a release "
                f"(identify decay {argument('modes', 'auto')})"
            )
        changed = []
        if self.frequency is not None:
            own = dynamics.natural_frequency
            changed.append(f"natural frequency, {own * (1 + self.frequency[0]):.5g} Hz and not {own:.5g} Hz")
        if self.damping is not None:
            own = dynamics.damping_ratio
            now = own * max(1 + self.damping[0], SETTINGS.least_damping)
            least = "less than " if 1 + self.damping[0] < SETTINGS.least_damping else ""
            changed.append(f"damping ratio, {least}{now:.3g} and not {own:.3g}")
        if changed:
            found.append(
                f"{self.component} rings with another {' and another '.join(changed)}: stiffness, mass or damping "
                "have changed since they were identified, or the flow adds its own; forces near that frequency are "
                "wrong by as much"
            )
        return found


def contradictions(force: Force) -> list[str]:
    """What a record says against the dynamics that its force was worked out with: a sentence for each finding.

    Parameters
    ----------
    force
        The force, which holds the record.
    """

    def known(component: str) -> dict[str, Any]:
        part = force[component]
        return {"noise": part.noise, "steps": part.steps, "hum": part.hum}

    record = force.record
    if isinstance(record, CoupledRecord):
        decoupled = record.component_records(force.filled)
        peaks = [peak for name in force for peak in _peaks(decoupled[name], **known(name))]
        turning = turning_by_angles(force.recording, record.dynamics, force)
        return [*peak_sentences(peaks, record.dynamics.modes), *turning]
    single = record.component_records(force.filled)
    return [text for name in force for text in misfit_of(single[name], **known(name)).sentences(single[name].dynamics)]


def misfit_of(record: SingleRecord, *, noise: float, steps: Sequence[Step] = (), hum: Sequence[Line] = ()) -> Misfit:
    """A mode of a record that the dynamics lack, and a frequency or damping that has changed.

    Parameters
    ----------
    record
        The component with its record and dynamics.
    noise
        Standard uncertainty of a reading of the load [N].
    steps, hum
        Sudden changes of the force, and lines of hum, that were found in the record.
    """
    seen = _unbroken(record, steps, hum)
    if seen is None:
        return Misfit(record.dynamics.component)
    reading, within = seen
    release = release_in(record, reading.values, noise=noise)
    known = record.load
    if release is not None:
        return _possible(_after_release(release, record.dynamics), most=float(np.nanmax(known) - np.nanmin(known)))
    left = _without_steps(reading, within)
    found = _in_spectrum(left, record.dynamics, interval=reading.interval, noise=noise)
    return _possible(found, most=float(np.nanstd(known)))


def _peaks(record: ComponentRecord, *, noise: float, steps: Sequence[Step], hum: Sequence[Line]) -> list[Peak]:
    """A narrow peak in the reading of a decoupled component, in which no mode of the dynamics shows."""
    seen = _unbroken(record, steps, hum)
    if seen is None:
        return []
    reading, within = seen
    averaged = Averaged.of(_without_steps(reading, within), interval=reading.interval, noise=noise)
    mode = None if averaged is None else missing_mode(averaged, record.dynamics)
    return [] if mode is None else [Peak(record.dynamics.component, mode.mode.natural_frequency, mode.u_frequency)]


def _unbroken(
    record: ComponentRecord, steps: Sequence[Step], hum: Sequence[Line]
) -> tuple[Observation, list[Step]] | None:
    """The longest stretch of a reading without a gap, hum taken out, and the steps within; None where it is still."""
    reading = record.reading()
    lines = reading_of_lines(tuple(hum), count=reading.values.size, interval=reading.interval) if hum else 0.0
    edges = np.flatnonzero(np.diff(np.concatenate(([False], reading.present, [False])).astype(np.int8)))
    stretches = edges.reshape(-1, 2)
    if not len(stretches):
        return None
    first, last = (int(edge) for edge in stretches[np.argmax(stretches[:, 1] - stretches[:, 0])])
    last = min(last, first + SETTINGS.longest)
    values = (reading.values - lines)[first:last]
    if values.size < FEWEST_SAMPLES or float(np.ptp(values)) == 0:
        return None
    begin, end = first * reading.interval, last * reading.interval
    within = [replace(step, instant=step.instant - begin) for step in steps if begin <= step.instant < end]
    return replace(reading, values=values), within


def _without_steps(reading: Observation, steps: Sequence[Step]) -> Array:
    """Reading less the mean, the steps and the free motion that explain it best, shape (n,)."""
    columns = columns_of(list(steps), reading)
    sizes, *_ = np.linalg.lstsq(columns, reading.values, rcond=None)
    return np.asarray(reading.values - columns @ sizes)


def _possible(found: Misfit, *, most: float) -> Misfit:
    """The same without a size of the ringing that is more than the balance load has."""
    return found if found.size is None or found.size <= most else replace(found, size=None)


def _after_release(fit: DecayFit, dynamics: Dynamics) -> Misfit:
    """What a release tells."""
    seen = fit.dynamics
    changes = []
    for name in ("natural_frequency", "damping_ratio"):
        own = getattr(dynamics, name)
        u = float(np.hypot(seen.uncertainty(name), dynamics.uncertainty(name)))
        changes.append((getattr(seen, name) / own - 1, u / own) if own else (0.0, 1.0))
    further = [
        (number, mode)
        for number, mode in enumerate(seen.further_modes, start=2)
        if all(
            abs(mode.natural_frequency / known.natural_frequency - 1) > SETTINGS.same_mode for known in dynamics.modes
        )
    ]
    number, mode = max(further, key=lambda item: abs(item[1].share), default=(0, None))
    return Misfit(
        dynamics.component,
        missing=mode,
        u_frequency=seen.uncertainty(f"natural_frequency_{number}") if mode else 0.0,
        u_share=seen.uncertainty(f"share_{number}") if mode else 0.0,
        size=abs(mode.share * fit.height) if mode else None,
        frequency=_if_changed(changes[0]),
        damping=_if_changed(changes[1]),
        released=True,
    )


def _in_spectrum(values: Array, dynamics: Dynamics, *, interval: float, noise: float) -> Misfit:
    """What the spectrum of a record tells."""
    seen = Averaged.of(values, interval=interval, noise=noise)
    if seen is None:
        return Misfit(dynamics.component)
    found = missing_mode(seen, dynamics)
    size = None
    if found is not None:
        mode = found.mode
        width = max(4 * mode.damping_ratio * mode.natural_frequency, 2 * seen.resolution)
        near = np.abs(seen.frequency - mode.natural_frequency) < width
        size = float(np.sqrt(2 * np.sum(seen.power[near]) * seen.resolution))
    own = own_resonance(seen, dynamics)
    changes: list[tuple[float, float] | None] = [None, None]
    if own is not None and own[2] > SETTINGS.changed:
        for index, name in enumerate(("natural_frequency", "damping_ratio")):
            known = dynamics.uncertainty(name) / getattr(dynamics, name)
            u = float(np.hypot(np.sqrt(own[1][index, index]), known))
            changes[index] = _if_changed((float(np.expm1(own[0][index])), u))
    return Misfit(
        dynamics.component,
        missing=None if found is None else found.mode,
        u_frequency=0.0 if found is None else found.u_frequency,
        u_share=0.0 if found is None else found.u_share,
        size=size,
        frequency=changes[0],
        damping=changes[1],
    )


def _if_changed(change: tuple[float, float]) -> tuple[float, float] | None:
    """A change with its uncertainty where it is more than chance."""
    return change if abs(change[0]) > SETTINGS.drift * change[1] else None
