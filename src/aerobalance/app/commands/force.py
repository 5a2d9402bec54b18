"""The command force."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from aerobalance.app.commands.balance_files import BalanceFiles
from aerobalance.app.commands.doubts import doubt_result
from aerobalance.app.commands.loads import LoadSource, LoadsSummary
from aerobalance.app.commands.shared import Result, check_out, collected_warnings, opened
from aerobalance.app.commands.uncertainty import (
    Origins,
    budget_result,
    budget_rms,
    budget_text,
    force_text,
    monte_carlo_result,
    scalar_result,
)
from aerobalance.app.reports.force_curves import ForceCurves
from aerobalance.app.resident_memory import give_back_compiler, share_one_heap
from aerobalance.estimation.force import ForceWork
from aerobalance.estimation.force_collector import SummaryOfParts
from aerobalance.estimation.force_parts import ForcePart, WorstPart
from aerobalance.estimation.forces import ForceSettings
from aerobalance.estimation.result import ForceSummary
from aerobalance.estimation.spectra.line_noise import Hum
from aerobalance.estimation.spectra.noise_spectrum import NoiseSpectrum
from aerobalance.io import check_output
from aerobalance.io.columns import Append
from aerobalance.io.dynamics_file import read_any_dynamics, through_balance
from aerobalance.io.kinds import PAGE, TABLE
from aerobalance.io.results_file import force_columns, writing
from aerobalance.io.table import RESTS_ON_LIMIT
from aerobalance.recording.components import COMPONENTS, si_unit
from aerobalance.recording.doubts import Doubt, verdict_of
from aerobalance.recording.errors import warn_quality
from aerobalance.recording.recording import Recording
from aerobalance.recording.side_by_side import handing_over_soon, side_by_side
from aerobalance.uncertainty.monte_carlo import MonteCarlo, monte_carlo

DEFAULT_SEED: Final = 1
"""Seed of Monte Carlo where none is given, so that the same inputs give the same result."""


class Check(NamedTuple):
    """A Monte Carlo check that is wanted.

    Attributes
    ----------
    draws
        Number of draws.
    seed
        Seed that they come from.
    """

    draws: int
    seed: int = DEFAULT_SEED


def force(
    path: Path,
    out: Path,
    *,
    dynamics: Path,
    settings: ForceSettings | None = None,
    noise_record: Path | None = None,
    files: BalanceFiles | None = None,
    channel_map: Path | None = None,
    check: Check | None = None,
    report: Path | None = None,
) -> Result:
    """Force applied, with its uncertainty, from balance loads or, with a balance, from gauge outputs."""
    share_one_heap()
    check_output(out)
    known = read_any_dynamics(dynamics)
    settings = ForceSettings() if settings is None else settings
    source = LoadSource(known, files, settings.gravity, channel_map)
    inputs = [path, dynamics, *source.paths, *([] if noise_record is None else [noise_record])]
    check_out(out, *inputs, kind=TABLE)
    check_out(report, *inputs, out, kind=PAGE)
    doubts: list[Doubt] = []

    def said_by_doubt(text: str) -> bool:  # a limit is told of on reading, for those who only read
        limited = [doubt.component for doubt in doubts if doubt.kind == "clipping"]
        return any(f"{name} {RESTS_ON_LIMIT}" in text for name in limited)

    with collected_warnings(said_by_doubt) as collected, opened(path, channel_map) as record:
        if files is not None:
            source = source._replace(known=through_balance(files.balance, known, dynamics=dynamics))
        work = ForceWork(
            record,
            source.known,
            made_ready=source.reduction(),
            noise=None if noise_record is None else source.read(noise_record),
            settings=settings,
        )
        with writing(out, samples=record.samples, epoch=record.epoch) as append, handing_over_soon():
            found = _worked_out(work, out, append, pictured=report is not None)
            checked = _checked(work, found, check)
        doubts += [doubt for one in found.summaries.values() for doubt in one.doubts]
    verdict = verdict_of(doubts, {name: one.size for name, one in found.summaries.items()})
    origins = Origins(found.origin, dynamics, None if files is None else files.balance)
    summaries = found.summaries
    result: Result = {
        "written": out.name,
        "verdict": str(verdict),
        "doubts": [doubt_result(doubt) for doubt in doubts],
        "assumed": [asdict(assumed) for one in found.summaries.values() for assumed in one.assumed],
        "components": {
            name: _component_result(summaries[name], origins, found.noises.get(name), checked.get(name))
            for name in summaries
        },
        "components_without_dynamics": [name for name in COMPONENTS if name in found.origin and name not in summaries],
        **({} if found.loads is None else {"loads": found.loads.result()}),
        "warnings": collected,
    }
    if report is not None:
        from aerobalance.app.reports.force_report import write_force_report  # noqa: PLC0415 - plotting is slow

        write_force_report(
            report, result, summaries, found.curves, recording=found.origin, dynamics=source.known, inputs=inputs
        )
        result["report"] = report.name
    result["file"] = path.name
    return {**result, "summary": force_text(result), "details": partial(budget_text, result["components"])}


@dataclass(slots=True, eq=False)
class _KeptForces:
    """What is kept of the forces of a record while its parts go by.

    Attributes
    ----------
    samples, every
        Samples of the clock that the record is worked out on, and of the record for each of them.
    origin
        A recording of the record's channels and start, without samples.
    summaries
        What sums up the forces.
    noises
        Spectra of the noise of the readings, where a record of noise was given.
    loads
        What sums up the balance loads, where they come from gauge outputs.
    curves
        What a page shows, where one is wanted.
    worst
        The part whose uncertainty is largest.
    """

    samples: int
    every: int = 1
    _origin: Recording | None = None
    _summaries: dict[str, SummaryOfParts] = field(default_factory=dict)
    noises: dict[str, NoiseSpectrum] = field(default_factory=dict)
    loads: LoadsSummary | None = None
    curves: dict[str, ForceCurves] = field(default_factory=dict)
    worst: WorstPart = field(default_factory=WorstPart)

    @property
    def origin(self) -> Recording:
        """A recording of the record's channels and start, without samples."""
        if self._origin is None:
            raise ValueError("no part of the record has a force")
        return self._origin

    @property
    def summaries(self) -> dict[str, ForceSummary]:
        """What sums up the forces, by component."""
        return {name: one.summary for name, one in self._summaries.items()}

    def add(self, given: ForcePart, start: float, *, pictured: bool) -> None:
        """Add a part of the record that begins at `start` [s]."""
        for name in given.values:
            if name not in self._summaries:
                self._summaries[name] = SummaryOfParts(name, self.samples, self.every)
                if pictured:
                    self.curves[name] = ForceCurves(self.samples, start, self.every)

        def add_one(name: str) -> None:
            self._summaries[name].add(given)
            if pictured:
                self.curves[name].add(given, name)

        side_by_side(add_one, given.values)
        force = given.force
        if force is None:
            return
        if self._origin is None:
            own = force.recording if given.clock is None else given.clock[0]
            empty = {name: replace(one, values=np.zeros(0)) for name, one in force.recording.channels.items()}
            self._origin = replace(own, channels=empty, start=start)
            self.noises = dict(force.noises)
        if force.loads is not None:
            self.loads = self.loads or LoadsSummary()
            self.loads.add(force.loads, given.own, every=self.every)
        self.worst.add(given)


def _worked_out(work: ForceWork, out: Path, append: Append, *, pictured: bool) -> _KeptForces:
    """Work out the forces of a record part by part, and write them as they come."""
    record = work.record
    found = _KeptForces(work.working.samples, work.working.every)
    if work.working.every > 1:  # all of it was looked at
        give_back_compiler()
    for given in work.parts():
        _append_samples(given, out, append)
        found.add(given, record.start, pictured=pictured)
        several = given.part.count > 1
        del given  # the next part needs the memory
        if several:
            give_back_compiler()
    return found


def _append_samples(given: ForcePart, out: Path, append: Append) -> None:
    """Write the forces of a part, some samples at a time."""
    for clock, own, values, uncertainty in given.samples_of_record():
        append(force_columns(out, clock, own, values, uncertainty))


def _checked(work: ForceWork, found: _KeptForces, check: Check | None) -> dict[str, MonteCarlo]:
    """Monte Carlo of a record; of one in parts that of the part that is known worst, which is said."""
    part = found.worst.part
    if check is None or part is None:
        return {}
    checked = monte_carlo(work.force_of(part), draws=check.draws, seed=check.seed)
    if part.count > 1:
        warn_quality(found.worst.told(work.working))
    for name, trial in checked.items():
        for text in trial.doubts:
            warn_quality(f"{work.record.name}: {name}: {text}")
    return checked


def _component_result(
    summary: ForceSummary, origins: Origins, noise: NoiseSpectrum | None, checked: MonteCarlo | None
) -> Result:
    """Plain data on one component."""
    result = force_result(summary, origins)
    if noise is not None:
        result["noise_spectrum"] = noise_result(noise)
    if checked is not None:
        result["monte_carlo"] = monte_carlo_result(checked)
    return result


def noise_result(spectrum: NoiseSpectrum) -> Result:
    """Plain data on a spectrum of noise."""
    return {
        "text": str(spectrum),
        "white": {
            "value": spectrum.white,
            "u": spectrum.u_white * spectrum.white,
            "unit": "unit of the load squared per Hz, two-sided",
        },
        "corner": {"value": spectrum.corner, "unit": "Hz"},
        "exponent": {"value": spectrum.exponent, "u": float(np.sqrt(spectrum.covariance[1, 1]))},
        "humps": [
            {"frequency": hump.frequency, "relative_width": hump.width, "level": hump.level} for hump in spectrum.humps
        ],
        "bands": [
            {"first": band.first, "last": band.last, "level": band.level, "exponent": band.exponent}
            for band in spectrum.bands
        ],
        "lines_left_out": list(spectrum.left_out),
    }


def hum_of(text: str) -> Hum:
    """What is to be taken for hum, from the words of the command line."""
    if text in ("mains", "keep"):
        return "mains" if text == "mains" else "keep"
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"--hum must be mains, keep or frequencies in Hz such as 50,100, not {text}") from None


def finite(value: float) -> float | None:
    """Return a number, or None where there is none."""
    return value if np.isfinite(value) else None


def force_result(estimate: ForceSummary, origins: Origins) -> Result:
    """Plain data on one component's force; instants are on the recording's own clock."""
    start = origins.recording.start
    unit = si_unit(estimate.component)
    return {
        "unit": unit,
        "mean_load": finite(estimate.mean_load),
        "mean_weight": finite(estimate.mean_weight),
        "method": estimate.method,
        **scalar_result(estimate, origins.recording),
        "uncertainty_rms": estimate.rms_uncertainty,
        "uncertainty_budget_rms": budget_rms(estimate),
        "noise_of_reading": estimate.noise,
        "bandwidth": {"value": estimate.bandwidth, "unit": "Hz"},
        "noise_gain": estimate.noise_gain,
        "steps": [
            {
                "instant": start + step.instant,
                "u_instant": step.instant_uncertainty,
                "duration": step.duration,
                "height": step.height,
                "u_height": step.height_uncertainty,
            }
            for step in estimate.steps
        ],
        "hum": [
            {"frequency": line.frequency, "u_frequency": line.u_frequency, "amplitude_in_reading": line.amplitude}
            for line in estimate.hum
        ],
        "tones": [{"frequency": line.frequency, "amplitude": line.amplitude} for line in estimate.tones],
        "assumptions": list(estimate.assumptions),
        **budget_result(estimate, origins),
    }
