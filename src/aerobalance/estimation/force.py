r"""From the gauge outputs or balance loads of a run to the forces and moments applied, Eq. (17) of [Gorbushin2020]_.

With several components it is F = X + D X' + A X'' - W + M x1''. Where they are coupled, each is decoupled from the
others (`aerobalance.dynamics.decoupling`) and then worked out as one component is: same estimator, same steps, same
warnings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import chain
from typing import Final, NamedTuple

import numpy as np

from aerobalance.balance.calibration.fit import Calibration
from aerobalance.balance.loads import Loads
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.reduction import reduction_of
from aerobalance.balance.zeros import Zero
from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.dynamics.independent import AnyDynamics, dynamics_of
from aerobalance.estimation.applied_force import Force
from aerobalance.estimation.checks.model_check import checked
from aerobalance.estimation.component_force import Method, by_smoother
from aerobalance.estimation.force_collector import ForceCollector
from aerobalance.estimation.force_parts import DIVISION, Division, ForcePart, Joiner, WorstPart
from aerobalance.estimation.force_record import ReadyRecord, force_record, noise_spectra
from aerobalance.estimation.forces import ForceRecord, ForceSettings, forces_of, with_matrix
from aerobalance.estimation.record import FEWEST_SAMPLES
from aerobalance.estimation.record_clock import RecordClock
from aerobalance.estimation.spectra.line_noise import Hum
from aerobalance.estimation.spectra.noise_spectrum import NoiseSpectrum
from aerobalance.estimation.working_clock import slower_clock
from aerobalance.estimation.working_record import (
    DecimatedRecord,
    MadeReady,
    OwnClock,
    RecordAsItIs,
    beside_pieces,
)
from aerobalance.recording.blas_threads import one_blas_thread
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import FitError, check_recording, kept_warnings, warn_quality
from aerobalance.recording.part_warnings import PartWarnings
from aerobalance.recording.parts import LongRecord, Part
from aerobalance.recording.progress import PROGRESS
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import gaps_in
from aerobalance.recording.side_by_side import Ahead, one_after_the_other

MANY_GAPS: Final = 16
"""Gaps of a channel in a part from which on a record is estimated on a slower clock although it is one part, and on
one that gains little else: its own smoother needs 8 to 30 ms for each and each component."""

FEWEST_SLOWER: Final = 2048
"""Samples of the slower clock that such a record has at least: at its ends the forces are less well known on it."""

FEWEST_FOR_THREADS: Final = 3 << 13
"""Samples of a part from which on its components are worked on side by side: of 2000 to 25 000 of six components two
threads take a quarter more of the processors than one, and as long."""


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
        with Ahead(self._ready, parts) as ahead:
            for place, part in enumerate(PROGRESS.each(parts, "part")):
                force: Force | None = None
                with told.of(part):
                    names, fast, ready = ahead.result(place)
                    if ready is not None:
                        whole = part.count == 1 and clock is None
                        force = self._undivided(ready, whole=whole, then=partial(ahead.begin, place + 1))
                del ready  # the next part needs the memory
                if joiner is None:
                    joiner = Joiner(record, tuple(force or names), self.division, told)
                if force is None:
                    silent.append(part)
                joined = joiner.joined(part, force)
                del force
                if clock is not None and fast is not None:
                    joined = clock.sampled(joined, fast)
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
            ready = self._ready(part).ready
            if ready is None:
                raise AssertionError
            return self._undivided(ready, whole=True)

    def _ready(self, part: Part) -> _Part:
        """A part made ready; wild samples of a record on a slower clock were looked for on its own."""
        read = self.working.part(part.begin, part.end)
        names = _present(read.given, self.dynamics)
        if part.count > 1 and not _has_readings(read.wanted, names):
            return _Part(names, read.clock, None)
        slower = self.working.every > 1
        settings = replace(self.settings, keep_outliers=True) if slower else self.settings
        return _Part(names, read.clock, ReadyRecord.of(read, self.dynamics, settings))

    def _undivided(self, ready: ReadyRecord, *, whole: bool, then: Callable[[], bool] = lambda: False) -> Force:
        """Forces of a part."""
        with one_after_the_other() if ready.given.samples < FEWEST_FOR_THREADS else nullcontext():
            return _undivided(ready, self.settings, noise=self.noise, whole=whole, then=then)


class _Part(NamedTuple):
    """A part of a record: its components, its record's own clock there if that is faster, and its readings if any."""

    components: tuple[str, ...]
    fast: OwnClock | None
    ready: ReadyRecord | None


def _present(given: Recording | Loads, dynamics: BalanceDynamics) -> tuple[str, ...]:
    """Components of the dynamics that a run has."""
    recording = given.recording if isinstance(given, Loads) else given
    return tuple(name for name in dynamics.components if name in recording)


def _has_readings(given: Recording | Loads, components: Sequence[str]) -> bool:
    """Whether a part of a run has enough readings of each component."""
    recording = given.recording if isinstance(given, Loads) else given
    counts = [np.count_nonzero(np.isfinite(recording.channel(name).values)) for name in components]
    return bool(min(counts, default=FEWEST_SAMPLES) >= FEWEST_SAMPLES)


def _undivided(
    ready: ReadyRecord,
    settings: ForceSettings,
    *,
    noise: Recording | Loads | Mapping[str, NoiseSpectrum] | None,
    whole: bool,
    then: Callable[[], bool],
) -> Force:
    """Forces of a run that is worked out at once.

    Parameters
    ----------
    ready
        The run.
    settings, noise
        As in `ForceWork`.
    whole
        Whether all contributions to the uncertainty are kept as they are, and not as few numbers as show.
    then
        Called when most of the memory and of both processors is done with; returns whether it has begun other work.
    """
    given, record, seen = ready
    model = record.dynamics
    dead = {doubt.component for doubt in seen if doubt.kind == "stuck channel"}
    told = given.doubts if isinstance(given, Loads) else ()
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
    beside = then()
    known = partial(_known, record, given if isinstance(given, Loads) else None)
    # what rounding leaves of a dead channel is no noise
    own = {
        name: tuple(doubt for doubt in part.doubts if name not in dead or doubt.kind != "colored noise")
        for name, part in parts.items()
    }
    parts = {name: replace(part, doubts=(*_of(name, told + seen), *own[name])) for name, part in parts.items()}
    with one_after_the_other() if beside else nullcontext():  # the next part is read beside it
        force = checked(Force(parts, known, settings, noises))
    for doubt in force.doubts:
        if doubt not in told:
            warn_quality(f"{given.name}: {doubt}")
    return force


def _of(component: str, doubts: Sequence[Doubt]) -> tuple[Doubt, ...]:
    return tuple(doubt for doubt in doubts if doubt.component == component)


def _known(record: ForceRecord, loads: Loads | None) -> tuple[ForceRecord, Loads | None]:
    return record, loads
