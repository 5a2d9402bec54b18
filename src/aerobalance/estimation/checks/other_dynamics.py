"""What a record says against the dynamics of one component: a mode that they lack, a spring that has changed.

First the evidence of other dynamics is compared with that of its own (`aerobalance.estimation.checks.resonance`).
Where that leaves them standing, the ringing after the steps of the record tells the frequency and the damping finely,
and in a long record so do the resonances of its spectrum.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from aerobalance.dynamics.modal import ModalModel, Mode
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.checks.asked_readings import longest_stretch, unbroken, without_steady_tones, without_steps
from aerobalance.estimation.checks.averaged_spectrum import Averaged
from aerobalance.estimation.checks.changing_resonance import changes_along, stretches_of
from aerobalance.estimation.checks.evidence import Evidence
from aerobalance.estimation.checks.local_modes import missing_mode, own_resonance
from aerobalance.estimation.checks.model_error import BY_PROBABILITY
from aerobalance.estimation.checks.peaks import Peak
from aerobalance.estimation.checks.resonance import left_open, spoken_for
from aerobalance.estimation.checks.spoken import Spoken
from aerobalance.estimation.checks.step_ringing import change_by_steps
from aerobalance.estimation.independent_record import SingleRecord
from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.estimation.record import ComponentRecord
from aerobalance.estimation.spectra.lines import Line
from aerobalance.estimation.steps import Step
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import argument
from aerobalance.recording.wording import frequency_text, share_text


@dataclass(frozen=True, slots=True)
class OtherDynamicsSettings:
    """Thresholds of the checks of dynamics against a record.

    Attributes
    ----------
    drift
        Standard uncertainties that frequency or damping has to be off before it is said to have changed.
    changed
        Gain in twice the log-likelihood that another frequency and damping must bring: chance has it once in 3
        million. The curvature at the optimum alone says too much of a resonance that the load hardly excites.
    least_damping
        Part of a known damping ratio below which only that it is smaller is said: so narrow a line is rather hum.
    told
        Uncertainty of a missing mode's share over it, up to which the error that it makes can be told.
    least_noise
        Least noise of a reading where evidence is compared, over the noise that was learned.
    beyond
        Factor that puts a natural frequency beyond all that is recorded.
    peaked, beside
        Density of the color of a noise at a mode over that beside it, so far away over its frequency on either side,
        from which on the color is the mode's: the edge of a band has its level on one side.
    """

    drift: float = 5.0
    changed: float = 30.0
    least_damping: float = 0.05
    told: float = 0.5
    least_noise: float = 1e-3
    beyond: float = 1e3
    peaked: float = 3.0
    beside: float = 0.1


ROUNDING: Final = 1e-9
"""Relative change of a damping ratio that is rounding."""

SETTINGS: Final = OtherDynamicsSettings()
"""Thresholds that are used."""


@dataclass(frozen=True, slots=True)
class OtherDynamics:
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
        Root mean square of its ringing in the balance load [N]; None where that is not told, or would be more than the
        load itself has.
    frequency, damping
        Relative change of natural frequency and damping ratio of the first mode with its standard uncertainty [1],
        NaN where that was not worked out; None where the record does not tell or nothing has changed.
    silent
        True where the balance does not ring at its natural frequency at all.
    possible
        Dynamics that the record leaves open, and how probable they are; None where it leaves none.
    within
        Samples of the record that show another frequency or damping ratio, and others do not; None where all do.
    during
        The same in words, with a comma before it.
    probability
        Probability of what it says [1].
    """

    component: str
    missing: Mode | None = None
    u_frequency: float = 0.0
    u_share: float = 0.0
    size: float | None = None
    frequency: tuple[float, float] | None = None
    damping: tuple[float, float] | None = None
    silent: bool = False
    possible: Spoken | None = None
    within: slice | None = None
    during: str = ""
    probability: float = 1.0

    @property
    def changed(self) -> bool:
        """Whether the first mode is clearly another."""
        return self.silent or self.frequency is not None or self.damping is not None

    def doubts(self, dynamics: Dynamics) -> list[ModelDoubt]:
        """What it says against the dynamics, one doubt for each finding."""
        found, unit = [], si_unit(self.component)
        sure = self.probability == 1
        likely = "" if sure else f" (probability {self.probability:.2g})"
        near = "forces near that frequency"
        if self.missing is not None:
            mode = self.missing
            size = "" if self.size is None else f" with {self.size:.3g} {unit} rms"
            cause = f"it swings{size}; a narrow band of the load itself looks the same"
            text = (
                f"{self.component} {'shows' if sure else 'may show'} a mode at "
                f"{frequency_text(mode.natural_frequency, self.u_frequency)}, "
                f"{share_text(mode.share, self.u_share)}, that the dynamics lack{self.during}{likely}: {cause}; "
                f"{near} {'are wrong until it is identified' if sure else BY_PROBABILITY}"
            )
            advice = f"identify it from a release (identify decay {argument('modes', 'auto')})"
            told = self.u_share < SETTINGS.told * abs(mode.share)
            other = dynamics.with_modes(*dynamics.further_modes, mode) if told else None
            found.append(
                ModelDoubt(Doubt("missing mode", self.component, text, advice, unit=unit), other, self.within)
            )
        if self.silent:
            text = (
                f"{self.component} {'does' if sure else 'may'} not ring at {dynamics.natural_frequency:.5g} Hz, the "
                f"natural frequency of the dynamics{likely}: they are those of another balance or another model, or "
                "the record has another rate than is said"
            )
            other = dynamics.retuned(frequency=SETTINGS.beyond, damping=1.0)
            doubt = Doubt("natural frequency", self.component, text, "identify the dynamics again", unit=unit)
            found.append(ModelDoubt(doubt, other))
        changed, kind = [], "natural frequency" if self.frequency is not None else "damping ratio"
        if self.frequency is not None:
            own = dynamics.natural_frequency
            changed.append(f"natural frequency, {own * (1 + self.frequency[0]):.5g} Hz and not {own:.5g} Hz")
        if self.damping is not None:
            own = dynamics.damping_ratio
            now = own * max(1 + self.damping[0], SETTINGS.least_damping)
            least = "less than " if 1 + self.damping[0] < SETTINGS.least_damping else ""
            changed.append(f"damping ratio, {least}{now:.3g} and not {own:.3g}")
        if changed:
            since = "on the way" if self.within else "since they were identified"
            text = (
                f"{self.component} {'rings' if sure else 'may ring'} with another {' and another '.join(changed)}"
                f"{self.during}{likely}: stiffness, mass or damping have changed {since}, or the flow adds its own; "
                f"{near} {'are wrong by as much' if sure else BY_PROBABILITY}"
            )
            advice = "identify the dynamics again"
            other = dynamics.retuned(
                frequency=1 + (self.frequency or (0.0,))[0],
                damping=max(1 + (self.damping or (0.0,))[0], SETTINGS.least_damping),
            )
            found.append(ModelDoubt(Doubt(kind, self.component, text, advice, unit=unit), other, self.within))
        return found


@dataclass(frozen=True, slots=True, eq=False)
class ModelDoubt:
    """A doubt of the dynamics, and the dynamics that would remove it.

    Attributes
    ----------
    doubt
        The doubt, its effect not known.
    other
        The dynamics that the record speaks for; None where it does not tell them.
    within
        Samples of the record that it is of; None for all.
    """

    doubt: Doubt
    other: ModalModel | None
    within: slice | None = None


def other_dynamics_in(
    record: SingleRecord,
    *,
    noise: float,
    steps: Sequence[Step] = (),
    lines: Sequence[Line] = (),
    learned: SpectralPrior | None = None,
    bends: Sequence[float] = (),
) -> OtherDynamics:
    """What a record says against its dynamics: other natural frequency or damping ratio, or a mode that they lack.

    Parameters
    ----------
    record
        The component with its record and dynamics.
    noise
        Standard uncertainty of a reading of the load [N].
    steps, lines
        Sudden changes of the force, and lines of its readings, that were found in the record.
    learned
        Prior of the force that was learned from it; None where none was.
    bends
        Instants of sudden changes of the force's slope [s]: what rings after each is of one course, and no noise.
    """
    dynamics = record.dynamics
    seen = unbroken(record, steps, lines)
    if seen is None:
        return OtherDynamics(dynamics.component)
    reading, within = seen
    known = record.load
    begin = longest_stretch(record).start * reading.interval
    end = begin + reading.values.size * reading.interval
    slopes = [Step(at - begin, end - at) for at in bends if begin <= at < end]  # each goes on up to the end

    def beside_steps(other: Dynamics, some: Sequence[Step], *, first: int = 0) -> Array:
        return without_steady_tones(
            without_steps(replace(reading, dynamics=other, values=reading.values[first:]), some)
        )

    ask = partial(
        spoken_for,
        dynamics=dynamics,
        interval=reading.interval,
        least_noise=max(reading.least_noise, SETTINGS.least_noise * noise),
        learned=learned,
        color_found=record.noise is None,
    )
    spoken = ask(without_steady_tones(reading.values), steps=[*within, *slopes], beside_steps=beside_steps)
    load = None
    if spoken is not None and spoken.probability == 0:
        load, spoken = spoken.mode.natural_frequency, None
    # of 168 records of 10 s and more with other dynamics, all along or in a part, none looked like narrow loads alone
    if load is None and (spoken is None or spoken.kind != "no resonance"):
        changed = _changed_along(record, ask, steps=steps, lines=lines, whole=spoken)
        if changed is not None:
            return changed
    if spoken is not None and spoken.probability == 1:
        return as_said(spoken, dynamics)
    left = beside_steps(dynamics, within)
    found = _possible(
        _in_spectrum(left, dynamics, interval=reading.interval, noise=noise, load=load),
        most=float(np.nanstd(known)),
    )
    if found.missing is not None and (
        (learned is not None and _looks_alike(found.missing, learned, reading.interval))
        or not _gains(found.missing, left, reading, noise=noise)
    ):
        found = replace(found, missing=None, size=None)
    if within and learned is not None:
        change, covariance, gain = change_by_steps(reading, within, learned)
        both = [
            if_changed(float(one), float(np.hypot(np.sqrt(variance), dynamics.uncertainty(name) / own)))
            for one, variance, name, own in zip(
                change,
                np.diag(covariance),
                ("natural_frequency", "damping_ratio"),
                (dynamics.natural_frequency, dynamics.damping_ratio or 1.0),
                strict=True,
            )
        ]
        if any(both) and gain > SETTINGS.drift**2:
            found = replace(found, frequency=both[0], damping=both[1])
        elif spoken is None:
            moved = dynamics.retuned(frequency=float(np.exp(change[0])), damping=float(np.exp(change[1])))
            spoken = left_open(Spoken("natural frequency", moved, gain / 2), gain / 2)
    possible = None if spoken is None or found.changed else spoken
    return replace(found, possible=possible)


def _changed_along(
    record: SingleRecord,
    ask: Callable[[Array], Spoken | None],
    *,
    steps: Sequence[Step],
    lines: Sequence[Line],
    whole: Spoken | None,
) -> OtherDynamics | None:
    """Dynamics that a part of a record speaks for more clearly than the whole does; None where there is none.

    `ask` gives what readings speak for, `whole` is what all of them do; `steps` and `lines` as of `other_dynamics_in`.
    """
    stretch = longest_stretch(record)
    if not stretches_of(stretch.stop - stretch.start, record.interval, record.dynamics):
        return None
    seen = unbroken(record, steps, lines, longest=record.load.size)
    if seen is None:
        return None
    reading, inside = seen
    values = without_steady_tones(reading.values)
    found = changes_along(values, record.dynamics, ask, interval=reading.interval, steps=inside)
    if found is None or (whole is not None and found.spoken.gain < whole.gain):
        return None
    first = stretch.start
    # it may have changed anywhere in the stretches beside these
    within = slice(max(first + found.first - found.each, 0), first + found.last + found.each)
    if found.spoken.probability < 1:
        return OtherDynamics(record.dynamics.component, possible=found.spoken, within=within)
    begin, end = (record.recording.start + (first + place) * reading.interval for place in (found.first, found.last))
    during = f", from about {begin:.4g} s to {end:.4g} s"
    return replace(as_said(found.spoken, record.dynamics), within=within, during=during)


def as_said(spoken: Spoken, dynamics: Dynamics) -> OtherDynamics:
    """Return what a record says against dynamics that speaks for others, clearly or with some probability."""
    return replace(_said(spoken, dynamics), probability=spoken.probability)


def _said(spoken: Spoken, dynamics: Dynamics) -> OtherDynamics:
    """The same, whatever the probability."""
    other = spoken.dynamics
    if spoken.kind == "missing mode":
        mode = other.further_modes[-1]
        found = OtherDynamics(dynamics.component, missing=mode, u_frequency=spoken.u * mode.natural_frequency)
        return replace(found, u_share=spoken.u_share * abs(mode.share))
    if spoken.kind == "no resonance":
        return OtherDynamics(dynamics.component, silent=True)
    ratio = other.damping_ratio / dynamics.damping_ratio - 1 if dynamics.damping_ratio else 0.0
    frequency = other.natural_frequency / dynamics.natural_frequency - 1, spoken.u
    if spoken.kind == "damping ratio":
        return OtherDynamics(dynamics.component, damping=(ratio, np.nan))
    return OtherDynamics(
        dynamics.component, frequency=frequency, damping=(ratio, np.nan) if abs(ratio) > ROUNDING else None
    )


def _gains(mode: Mode, left: Array, reading: Observation, *, noise: float) -> bool:
    """Whether a further mode is likelier than none where the force has any spectrum and no power of frequency.

    The two edges of a narrow band may leave one where its spectrum is taken for a power of frequency with one edge.
    """
    known = reading.dynamics
    other = known.with_modes(*known.modes[1:], mode)
    floor = (SETTINGS.least_noise * noise) ** 2 * reading.interval
    evidence = Evidence(left - left.mean(), reading.interval, floor, among=(known, other))
    return evidence.of(other) > evidence.of(known)


def _looks_alike(mode: Mode, learned: SpectralPrior, interval: float) -> bool:
    """Whether a force above the natural frequency or the color of the noise there has edges that look like a mode."""
    if learned.rising:
        away = np.linspace(0.2, 1.5, 14) * SETTINGS.beside
        below, above = (
            float(learned.spectrum.density(mode.natural_frequency * (1 + side * away)).min()) for side in (-1, 1)
        )
        there = float(learned.spectrum.density(np.array([mode.natural_frequency]))[0])
        low, high = sorted((below, above))
        # a force that stands for a mode has a peak for its resonance, and a hole beside it for its antiresonance
        return not (there > SETTINGS.peaked * high and high > SETTINGS.peaked * low)
    if learned.color is None:
        return False
    near = mode.natural_frequency * (1 + SETTINGS.beside * np.array([-1.0, 0.0, 1.0]))
    below, there, above = learned.color.density(near, width=0.0)
    # an edge has its level on one side of it: what stands out of both is the mode, taken for a color
    peaked = there > SETTINGS.peaked * max(below, above)
    return bool(there > learned.noise**2 * interval and not peaked)


def peaks_of(record: ComponentRecord, *, noise: float, steps: Sequence[Step], lines: Sequence[Line]) -> list[Peak]:
    """A narrow peak in the reading of a decoupled component, in which no mode of the dynamics shows."""
    seen = unbroken(record, steps, lines)
    if seen is None:
        return []
    reading, within = seen
    averaged = Averaged.of(without_steps(reading, within), interval=reading.interval, noise=noise)
    mode = None if averaged is None else missing_mode(averaged, record.dynamics, largest_share=np.inf)
    return [] if mode is None else [Peak(record.dynamics.component, mode.mode.natural_frequency, mode.u_frequency)]


def _possible(found: OtherDynamics, *, most: float) -> OtherDynamics:
    """The same without a size of the ringing that is more than the balance load has."""
    return found if found.size is None or found.size <= most else replace(found, size=None)


def _in_spectrum(
    values: Array, dynamics: Dynamics, *, interval: float, noise: float, load: float | None
) -> OtherDynamics:
    """What the spectrum of a record tells, which may show a load in a narrow band about some frequency [Hz]."""
    seen = Averaged.of(values, interval=interval, noise=noise)
    if seen is None:
        return OtherDynamics(dynamics.component)
    found = missing_mode(seen, dynamics, load=load)
    size = None
    if found is not None:
        mode = found.mode
        width = max(4 * mode.damping_ratio * mode.natural_frequency, 2 * seen.resolution)
        near = np.abs(seen.frequency - mode.natural_frequency) < width
        size = float(np.sqrt(2 * np.sum(seen.power[near]) * seen.resolution))
    width = 2 * dynamics.damping_ratio * dynamics.natural_frequency
    own = own_resonance(seen, dynamics) if seen.resolution < width else None
    changes: list[tuple[float, float] | None] = [None, None]
    if own is not None and own[2] > SETTINGS.changed:
        for index, name in enumerate(("natural_frequency", "damping_ratio")):
            known = dynamics.uncertainty(name) / getattr(dynamics, name)
            u = float(np.hypot(np.sqrt(own[1][index, index]), known))
            changes[index] = if_changed(float(own[0][index]), u)
    return OtherDynamics(
        dynamics.component,
        missing=None if found is None else found.mode,
        u_frequency=0.0 if found is None else found.u_frequency,
        u_share=0.0 if found is None else found.u_share,
        size=size,
        frequency=changes[0],
        damping=changes[1],
    )


def if_changed(change: float, u: float) -> tuple[float, float] | None:
    """A relative change with its uncertainty where its logarithm, found with an uncertainty, is more than chance.

    A factor that is hardly told may be large, and its excess over one then says nothing: exp(1.7) - 1 is 4.5, which is
    six times the 0.7 that the logarithm is uncertain by, and yet 1.7 is no more than 2.4 times that.
    """
    factor = float(np.exp(change))
    return (float(np.expm1(change)), factor * u) if abs(change) > SETTINGS.drift * u else None
