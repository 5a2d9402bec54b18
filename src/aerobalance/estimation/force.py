r"""From the gauge outputs or balance loads of a run to the forces and moments applied, Eq. (17) of [Gorbushin2020]_.

With several components it is F = X + D X' + A X'' - W + M x1''. Where they are coupled, each is decoupled from the
others (`aerobalance.dynamics.decoupling`) and then worked out as one component is: same estimator, same steps, same
warnings.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import chain
from typing import Final

import numpy as np

from aerobalance.balance.calibration.fit import Calibration
from aerobalance.balance.loads import Loads
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.reduction import reduction_of
from aerobalance.balance.zeros import Zero
from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.independent import AnyDynamics, IndependentDynamics, dynamics_of
from aerobalance.estimation.applied_force import Force
from aerobalance.estimation.checks.impossible_channels import impossible_channels
from aerobalance.estimation.checks.model_check import checked
from aerobalance.estimation.checks.outliers import without_wild_samples
from aerobalance.estimation.component_force import Method, by_smoother, noise_of_component
from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.estimation.force_collector import ForceCollector
from aerobalance.estimation.force_parts import DIVISION, Division, ForcePart, Joiner, WorstPart
from aerobalance.estimation.forces import ForceRecord, ForceSettings, forces_of, with_matrix
from aerobalance.estimation.independent_record import IndependentRecord
from aerobalance.estimation.record import FEWEST_SAMPLES
from aerobalance.estimation.record_clock import RecordClock
from aerobalance.estimation.spectra.line_noise import Hum
from aerobalance.estimation.spectra.noise_spectrum import NoiseSpectrum
from aerobalance.estimation.working_clock import slower_clock
from aerobalance.estimation.working_record import (
    DecimatedRecord,
    MadeReady,
    RecordAsItIs,
    beside_pieces,
    unfiltered_part,
)
from aerobalance.recording.blas_threads import one_blas_thread
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY, loads_hint
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import FitError, check_recording, kept_warnings, warn_quality
from aerobalance.recording.part_warnings import PartWarnings
from aerobalance.recording.parts import LongRecord, Part
from aerobalance.recording.progress import PROGRESS
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import gaps_in, interpolate_gaps
from aerobalance.recording.side_by_side import one_after_the_other

MANY_GAPS: Final = 16
"""Gaps of a channel in a part from which on a record is estimated on a slower clock although it is one part, and on
one that gains little else: its own smoother needs 8 to 30 ms for each and each component."""

FEWEST_SLOWER: Final = 2048
"""Samples of the slower clock that such a record has at least: at its ends the forces are less well known on it."""

FEWEST_FOR_THREADS: Final = 1 << 15
"""Samples of a part from which on its components are worked on side by side: of 2000 to 25 000 of six components two
threads take a quarter more of the processors than one, and as long."""

SAME_WEIGHT: Final = 1e-3
"""Difference of two weights, over the largest, that attitudes which are averaged may make."""


@one_blas_thread()
def estimate_force(
    run: Recording | Loads,
    dynamics: AnyDynamics,
    *,
    balance: BalanceMatrix | Calibration | None = None,
    zero: Zero | None = None,
    noise: Recording | Loads | Mapping[str, NoiseSpectrum] | None = None,
    method: Method = "smoother",
    bandwidth: float | None = None,
    gravity: float = STANDARD_GRAVITY,
    gravity_uncertainty: float = 0.0,
    hum: Hum = "mains",
    keep_outliers: bool = False,
    align: bool = False,
) -> Force:
    """Forces and moments applied [N, N*m], Eq. (17) of [Gorbushin2020]_, with a standard uncertainty of every sample.

    Parameters
    ----------
    run
        Balance loads, and ground acceleration and attitude where they are recorded; or with `balance` gauge outputs.
        Loads that were worked out from gauge outputs are given as `Loads`, which hold the matrix and its errors.
    dynamics
        Mass, stiffness and damping of one component or of several, or coupled dynamics, with their covariance.
    balance, zero
        Where gauge outputs are given: the balance matrix or its calibration, and the zero that they count from.
    noise
        A record of noise alone (wind off, balance at rest) with the sampling rate, gains and filters of the run, or
        spectra by component as `noise_spectra` finds them. Without one the noise is taken as white, but for what the
        run itself shows far above the natural frequency.
    method, bandwidth, gravity, gravity_uncertainty, hum, keep_outliers, align
        See `ForceSettings`.

    Raises
    ------
    FitError
        The run has none of the components, lacks one that the others are coupled with, is too short, or has missing
        samples that the method cannot bridge; or the noise was recorded at another sampling rate.
    ValueError
        A setting is not allowed, or the loads count from the weight of the model and do not say what it is.
    """
    check_recording(run)
    settings = ForceSettings(method, bandwidth, gravity, gravity_uncertainty, hum, keep_outliers, align)
    model = dynamics_of(dynamics)
    if balance is None and zero is not None:
        raise ValueError("a zero is of gauge outputs: give the balance matrix that makes loads of them as well")

    made_ready = reduction_of(balance, zero=zero, model=model, gravity=gravity)
    calm = made_ready(noise) if isinstance(noise, Recording | Loads) else noise
    return ForceWork(run, model, made_ready=made_ready, noise=calm, settings=settings).force()


@dataclass(frozen=True, slots=True, eq=False)
class ForceWork:
    """What the forces of a record of any length are worked out from.

    Attributes
    ----------
    record
        As `run` in `estimate_force`, or a record in a file of which no more than a part is in memory.
    dynamics
        The components.
    made_ready
        Makes loads of the samples of a part that are gauge outputs.
    noise
        A record of noise alone, made ready, or spectra by component.
    settings
        How the forces are worked out.
    division
        How the record is divided.
    """

    record: LongRecord[Recording | Loads]
    dynamics: BalanceDynamics
    made_ready: MadeReady = lambda given: given
    noise: Recording | Loads | Mapping[str, NoiseSpectrum] | None = None
    settings: ForceSettings = field(default_factory=ForceSettings)
    division: Division = field(default_factory=lambda: DIVISION)
    _working: list[RecordAsItIs | DecimatedRecord] = field(init=False, default_factory=list)

    @property
    def working(self) -> RecordAsItIs | DecimatedRecord:
        """The record on the clock that its forces are worked out on."""
        if not self._working:
            self._working.append(self._on_slower_clock() or self._as_it_is())
        return self._working[0]

    def _as_it_is(self) -> RecordAsItIs:
        """The record on its own clock; one that is worked out at once has nothing beside it."""
        divided = self.record.samples > self.division.length(self.dynamics)
        return RecordAsItIs(self.record, self.made_ready, beside_pieces(self.record) if divided else 0)

    def _on_slower_clock(self) -> DecimatedRecord | None:
        """The record on a slower clock, where it is long or has many gaps, and the method can do with it."""
        own = self.settings
        if (
            self.noise is not None
            or own.align
            or own.keep_outliers
            or not by_smoother(method=own.method, bandwidth=own.bandwidth)
        ):
            return None
        if self.record.samples > self.division.length(self.dynamics):
            slower = slower_clock(self.record, self.dynamics, self.made_ready)
            if slower is not None:
                return slower
        if not self._has_many_gaps():
            return None
        slower = slower_clock(self.record, self.dynamics, self.made_ready, gaps=True)
        return slower if slower is not None and slower.samples >= FEWEST_SLOWER else None

    def _has_many_gaps(self) -> bool:
        """Whether a channel has so many gaps within the length of a part that they would take most of the time."""
        samples, length = self.record.samples, self.division.length(self.dynamics)
        with kept_warnings():  # given when the forces are estimated
            for begin in range(0, samples, length):
                given = self.record.part(begin, min(begin + length, samples))
                recording = given.recording if isinstance(given, Loads) else given
                if any(len(gaps_in(np.isnan(one.values))) > MANY_GAPS for one in recording):
                    return True
        return False

    def parts(self) -> Iterator[ForcePart]:
        """Forces of the record [N, N*m], part by part; a record that is short enough is one part.

        Raises
        ------
        FitError
            As in `estimate_force`; no part of the record has readings.
        """
        record = self.working
        parts = self.division.parts(record, self.dynamics, every=record.every, shown=record.shown)
        clock = RecordClock(record) if isinstance(record, DecimatedRecord) else None
        told = PartWarnings(record)
        joiner: Joiner | None = None
        silent: list[Part] = []
        for part in PROGRESS.each(parts, "part"):
            force: Force | None = None
            with told.of(part):
                given, own = record.part(part.begin, part.end), record.own(part.begin, part.end)
                names = _present(given, self.dynamics)
                if part.count == 1 or _has_readings(_own_of(given, own), names):
                    force = self._undivided(given, own, whole=part.count == 1 and clock is None)
            del given  # the next part needs the memory
            if joiner is None:
                joiner = Joiner(record, tuple(force or names), self.division, told)
            if force is None:
                silent.append(part)
            joined = joiner.joined(part, force)
            del force
            if clock is not None:
                joined = clock.sampled(joined)
            yield joined
            del joined
        if len(silent) == len(parts):
            raise FitError(f"{record.name}: no part of the record has {FEWEST_SAMPLES} readings of each component")
        for part in silent:
            told.add(part, f"{record.name}: there are not {FEWEST_SAMPLES} readings, and there is no force")
        told.tell()

    def force(self) -> Force:
        """Forces of a record that is in memory, its parts put together."""
        parts = self.parts()
        first = next(parts)
        working = self.working
        if first.part.count == 1 and isinstance(first.force, Force) and working.every == 1:
            return first.force
        worst = WorstPart()

        def watched() -> Iterator[ForcePart]:
            for given in chain([first], parts):
                worst.add(given)
                yield given

        def force_of_worst() -> tuple[Force, str]:
            if worst.part is None:
                raise AssertionError
            return self.force_of(worst.part), worst.told(working)

        found = ForceCollector(self.record.samples, working.samples, working.every).collected(watched())
        # the whole record is worked out where it is asked for: as much work as the forces of some of its parts
        return Force(found, cache(self._whole), self.settings, worst=force_of_worst)

    def _whole(self) -> tuple[ForceRecord, Loads | None]:
        """The whole of a record that is in memory."""
        with kept_warnings():  # said of the parts
            given = self.made_ready(self.record.part(0, self.record.samples))
            record = force_record(given, self.dynamics, **self.settings.earth)
        return record, given if isinstance(given, Loads) else None

    def force_of(self, part: Part) -> Force:
        """Forces of one part with all that their uncertainty consists of; what is to be said of it was said before."""
        with kept_warnings():
            own = self.working.own(part.begin, part.end)
            return self._undivided(self.working.part(part.begin, part.end), own, whole=True)

    def _undivided(self, given: Recording | Loads, own: slice | None, *, whole: bool) -> Force:
        """Forces of a part; wild samples of a record on a slower clock were looked for on its own."""
        slower = self.working.every > 1
        settings = replace(self.settings, keep_outliers=True) if slower else self.settings
        with one_after_the_other() if given.samples < FEWEST_FOR_THREADS else nullcontext():
            return _undivided(
                given,
                self.dynamics,
                settings,
                noise=self.noise,
                whole=whole,
                known_before=self.working.doubts,
                wanted=own,
            )


def _present(given: Recording | Loads, dynamics: BalanceDynamics) -> tuple[str, ...]:
    """Components of the dynamics that a run has."""
    recording = given.recording if isinstance(given, Loads) else given
    return tuple(name for name in dynamics.components if name in recording)


def _own_of(given: Recording | Loads, own: slice | None) -> Recording | Loads:
    """Those samples of a run that a part has for its own; all where none are named."""
    return given if own is None else given.part(own.start, own.stop)


def _has_readings(given: Recording | Loads, components: Sequence[str]) -> bool:
    """Whether a part of a run has enough readings of each component."""
    recording = given.recording if isinstance(given, Loads) else given
    counts = [np.count_nonzero(np.isfinite(recording.channel(name).values)) for name in components]
    return bool(min(counts, default=FEWEST_SAMPLES) >= FEWEST_SAMPLES)


def _undivided(
    given: Recording | Loads,
    model: BalanceDynamics,
    settings: ForceSettings,
    *,
    noise: Recording | Loads | Mapping[str, NoiseSpectrum] | None,
    whole: bool,
    known_before: tuple[Doubt, ...] = (),
    wanted: slice | None = None,
) -> Force:
    """Forces of a run that is worked out at once.

    Parameters
    ----------
    given
        The run, its gauge outputs made loads.
    model, settings, noise
        As in `force_parts`.
    whole
        Whether all contributions to the uncertainty are kept as they are, and not as few numbers as show.
    known_before
        Doubts about readings that were found before it was put on a slower clock.
    wanted
        Samples of the run whose force it is; filters of its channels are undone with the others beside them as well.
        All where left out.
    """
    if isinstance(given, Recording) and given.from_outputs:
        warn_quality(
            f"{given.name}: the loads were worked out from gauge outputs, and the errors of the balance matrix are "
            "not in the uncertainty: give the loads as reduce_outputs returns them, not their recording alone"
        )
    seen = impossible_channels(_own_of(given, wanted), model)
    dead = {doubt.component for doubt in seen if doubt.kind == "stuck channel"}
    told = given.doubts if isinstance(given, Loads) else ()
    if not settings.keep_outliers:
        given, wild = without_wild_samples(given, model.components, own=wanted)
        seen += wild
    seen += known_before
    if wanted is not None:
        given = unfiltered_part(given, wanted)
    record = force_record(given, model, **settings.earth)
    if isinstance(noise, Recording | Loads):
        noise = noise_spectra(noise, record, **settings.earth)
    noises = {} if noise is None else noise
    unknown = [name for name in noises if name not in model.components]
    if unknown:
        raise ValueError(
            f"noise has {', '.join(unknown)}, which the dynamics do not have; they have {', '.join(model.components)}"
        )
    parts = forces_of(record, settings, noises=noises, few=not whole)
    if isinstance(given, Loads):
        parts = with_matrix(parts, given, model)
    known = partial(_known, record, given if isinstance(given, Loads) else None)
    # what rounding leaves of a dead channel is no noise
    own = {
        name: tuple(doubt for doubt in part.doubts if name not in dead or doubt.kind != "colored noise")
        for name, part in parts.items()
    }
    parts = {name: replace(part, doubts=(*_of(name, told + seen), *own[name])) for name, part in parts.items()}
    force = checked(Force(parts, known, settings, noises))
    for doubt in force.doubts:
        if doubt not in told:
            warn_quality(f"{given.name}: {doubt}")
    return force


def _of(component: str, doubts: Sequence[Doubt]) -> tuple[Doubt, ...]:
    return tuple(doubt for doubt in doubts if doubt.component == component)


def _known(record: ForceRecord, loads: Loads | None) -> tuple[ForceRecord, Loads | None]:
    return record, loads


def force_record(
    run: Recording | Loads,
    dynamics: AnyDynamics,
    *,
    gravity: float = STANDARD_GRAVITY,
    gravity_uncertainty: float = 0.0,
) -> ForceRecord:
    """The balance loads [N, N*m] of a run with dynamics and the motion of the ground, ready for the estimator.

    Raises
    ------
    FitError
        The run has none of the components, lacks one that the others are coupled with, or is too short.
    ValueError
        The loads count from the weight of a model and do not say what it is.
    """
    model, noise = dynamics_of(dynamics), None
    if isinstance(run, Loads):
        run.check_ready()
        _check_mass(run, model)
        noise = _noise_of(run, model)
        run = run.recording
    if not any(name in run for name in model.components):
        raise FitError(
            f"{run.name} has none of the components of the dynamics, {', '.join(model.components)}; it has "
            f"{', '.join(run.channels) or 'no channels'}{loads_hint(run.channels)}"
        )
    settings = {"gravity": gravity, "gravity_uncertainty": gravity_uncertainty}
    if isinstance(model, CoupledDynamics):
        return CoupledRecord.of(run, model, noise=noise, **settings)
    if isinstance(model, IndependentDynamics):
        return IndependentRecord.of(run, model, **settings)
    raise AssertionError


def _noise_of(loads: Loads, model: BalanceDynamics) -> Array | None:
    """Covariance of the noise of a model's components, shape (n, n); None where the loads lack one or its noise."""
    if any(name not in loads.components for name in model.components):
        return None
    place = [loads.components.index(name) for name in model.components]
    found = loads.noise_covariance[np.ix_(place, place)]
    return found if np.diag(found).all() else None


def _check_mass(loads: Loads, model: BalanceDynamics) -> None:
    """Refuse loads whose zero was read under the weight of another mass than the dynamics have."""
    put_back, gravity = loads.zero.weight, loads.zero.pull.acceleration
    size = float(np.linalg.norm(gravity))
    if not put_back.any() or size == 0:
        return
    aft, right, up = (float(gravity[COMPONENTS.index(name)]) for name in ("AF", "SF", "NF"))
    pitch, roll = np.array([np.arcsin(aft / size)]), np.array([np.arctan2(right, -up)])
    for name in model.components:
        own = float(model.weight(name, pitch=pitch, roll=roll, gravity=size)[0])
        there = float(put_back[COMPONENTS.index(name)])
        if abs(own - there) > SAME_WEIGHT * float(np.max(np.abs(put_back))):
            raise ValueError(
                f"{loads.recording.name}: the zero of these loads was taken to hold a weight of {there:.5g} along "
                f"{name}, and these dynamics weigh {own:.5g}; work the loads out with the same dynamics as their model"
            )


def noise_spectra(
    calm: Recording | Loads,
    run: ForceRecord,
    *,
    gravity: float = STANDARD_GRAVITY,
    gravity_uncertainty: float = 0.0,
) -> dict[str, NoiseSpectrum]:
    """Spectra of the noise of the components' readings [N^2/Hz], from a record of noise alone: wind off, at rest.

    The noise of a decoupled component is what its balance makes of the noise of all channels that have a part in it.
    So the record of noise goes through the very balances that the run is decoupled with, which depend on the white
    noise of the run's channels, and the spectrum is learned from what they read.

    Parameters
    ----------
    calm
        The record of noise, with the sampling rate, gains and filters of the run. The load that a recorded motion of
        the ground has put on it is taken off.
    run
        The run that the spectra are for.
    gravity, gravity_uncertainty
        Local acceleration of gravity and its standard uncertainty [m/s^2].

    Raises
    ------
    FitError
        The record lacks a component, is too short, or shows no noise.
    """
    record = force_record(calm, run.dynamics, gravity=gravity, gravity_uncertainty=gravity_uncertainty)
    records = record.with_noise(run.noise).component_records(interpolate_gaps(record.loads))
    lacking = [name for name in run.dynamics.components if name not in records]
    if lacking:
        raise FitError(
            f"{record.recording.name}: has no {', '.join(lacking)}, and the noise of each component worked out "
            "is needed; record it too, or work out the others by themselves"
        )
    return {name: noise_of_component(component) for name, component in records.items()}
