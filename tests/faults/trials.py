"""Works out the forces of the cases and compares them with the truth.

python -m faults.trials [--seeds 20] [--groups ground,samples] [--out build/faults.json]
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.applied_force import Force
from aerobalance.estimation.checks.evidence import Evidence
from aerobalance.estimation.checks.ground_witnesses import Witness
from aerobalance.estimation.component_force import Fitted
from aerobalance.estimation.force import estimate_force
from aerobalance.estimation.least_squares import log_likelihood
from aerobalance.estimation.observation import Observation
from aerobalance.estimation.steps import Step, columns_of
from aerobalance.recording.channel import Channel
from aerobalance.recording.components import COMPONENTS, si_unit
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.recording.recording import Recording
from faults.cases import Case, all_cases
from faults.scene import Record
from faults.six import HALF_RANGE

SHOWN = 10.0
"""Gain in log-likelihood from which on a record can show that its dynamics are others: of 1100 sound records one
gained as much by some dynamics near its own."""

LEAST_NOISE = 2e-3
"""Least noise of a reading where this is looked at [N]."""

SOUND = 2
"""Times as many seeds of each sound kind: how rarely these are doubted shows in thousands of records."""

UNITS = {"ground_acceleration": "m/s^2", "pitch": "rad"} | {name: si_unit(name) for name in COMPONENTS}


Array = np.ndarray[Any, np.dtype[np.float64]]


def recording_of(record: Record, name: str = "record") -> Recording:
    """Return the readings as a recording."""
    channels = {key: Channel(key, values, UNITS[key]) for key, values in record.columns.items()}
    return Recording.from_columns(np.arange(len(record.force)) / record.rate, channels, name=name)


def worked_out(
    record: Record, dynamics: Dynamics | CoupledDynamics, settings: dict[str, Any]
) -> tuple[Force | None, list[str]]:
    """Return the force, or None where it is refused, and what was said."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        try:
            found: Force | None = estimate_force(recording_of(record), dynamics, **settings)
        except (FitError, ValueError) as refused:
            return None, [str(refused)]
    return found, [str(one.message) for one in caught if issubclass(one.category, DataQualityWarning)]


def scores(force: Array, u: Array, truth: Array) -> dict[str, float]:
    """Return how far a force is off [N], and how well its uncertainty holds."""
    error = force - truth
    z = np.abs(error) / np.maximum(u, 1e-300)
    return {
        "error": float(np.sqrt(np.mean(error**2))),
        "u": float(np.sqrt(np.mean(u**2))),
        "cover": float(np.mean(z < 1.96)),
        "largest_z": float(np.max(z)),
        "load": float(np.std(truth)),
    }


def of_one(force: Force) -> tuple[Array, Array]:
    """Return a force and its uncertainty [N]."""
    return force.only.values, force.only.uncertainty


def in_percent(force: Force, truth: Array) -> tuple[Array, Array, Array]:
    """Return the forces of six components, their uncertainty and the truth, in percent of half range."""
    found, u = (np.column_stack([getattr(one, what) for one in force.values()]) for what in ("values", "uncertainty"))
    return 100 * found / HALF_RANGE, 100 * u / HALF_RANGE, 100 * truth / HALF_RANGE


def can_show(case: Case, record: Record, seed: int, found: Force | None) -> bool:
    """Return whether a record can show the fault: its readings are clearly likelier with what is right.

    That is the balance, the noise and the ground's motion that it has; the spectrum of the force is learned from the
    readings with either. Of noise with a color that holds beside the steps that were found: their own spectrum would
    hide it.
    """
    if case.right is not None and found is not None:
        right = worked_out(case.record(seed, right=True), case.known(seed), case.settings)[0]
        return right is not None and log_likelihood_of(right) - log_likelihood_of(found) > SHOWN
    if case.own is None and case.color is None:
        return case.shown
    steps: Sequence[Step] = () if found is None or len(found) > 1 else found.only.steps
    known = case.known(seed)
    (component,) = known.components
    load, interval = record.columns[component], 1 / record.rate
    if case.own is not None:
        load = load[int(case.since * load.size) :]
        evidence = Evidence(load - load.mean(), interval, LEAST_NOISE**2 * interval, among=(case.own, known))
        return evidence.of(case.own) - evidence.of(known) > SHOWN
    columns = columns_of(list(steps), Observation(load, interval, known))
    left = load - columns @ np.linalg.lstsq(columns, load)[0]
    assert case.color is not None
    plain, colored = (Evidence(left, interval, LEAST_NOISE**2 * interval) for _ in range(2))
    colored.white, colored.color = case.scene.noise**2 * interval, Color(case.color)
    return colored.of(known) - plain.of(known) > SHOWN


def log_likelihood_of(found: Force) -> float:
    """Return the log-likelihood of the readings of the one component of a force, by what was learned from them."""
    (component,) = found
    record = found.record.component_record(component)
    fit = Fitted.of(record, hum="mains").smoothed
    return log_likelihood(fit.reading, fit.filter, columns=Witness(record, fit).known)


@dataclass(frozen=True)
class Color:
    """A noise of known density, as `Evidence` takes it."""

    of: Callable[[Array, float], Array]

    def density(self, frequency: Array, *, width: float = 0.0) -> Array:
        """Mean density about frequencies [Hz] over a width [Hz], of their shape [N^2/Hz]."""
        return self.of(frequency, width)


def trial(given: tuple[Case, int]) -> dict[str, Any]:
    """Return what came of one record."""
    case, seed = given
    record, calm = case.record(seed), case.noise_alone(seed)
    settings = case.settings if calm is None else {**case.settings, "noise": recording_of(calm, "noise")}
    began = time.process_time()
    force, said = worked_out(record, case.known(seed), settings)
    spent = time.process_time() - began
    result: dict[str, Any] = {
        "name": case.name,
        "group": case.group,
        "seed": seed,
        "shown": can_show(case, record, seed, force),
        "expected": list(case.kinds),
        "said": said,
        "seconds": spent,
        "refused": force is None,
    }
    if force is not None:
        result |= scores(*in_percent(force, record.force)) if len(force) > 1 else scores(*of_one(force), record.force)
        result["verdict"] = str(getattr(force, "verdict", "fit for use"))
        result["kinds"] = [doubt.kind for doubt in getattr(force, "doubts", ())]
    return result


def by_place(place: tuple[int, int]) -> dict[str, Any]:
    """Return what came of one record, its case named by its place in the list."""
    return trial((all_cases()[place[0]], place[1]))


def main() -> None:
    """Run the trials and print a line for each case."""
    parser = argparse.ArgumentParser(description="Forces of faulty records against the truth.")
    parser.add_argument("--seeds", type=int, default=20, help=f"of each kind; {SOUND} times as many of sound ones")
    parser.add_argument("--groups", default="")
    parser.add_argument("--match", default="")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    groups = set(given.groups.split(",")) - {""}
    everything = all_cases()
    places = [
        i for i, case in enumerate(everything) if (not groups or case.group in groups) and given.match in case.name
    ]
    rows: list[dict[str, Any]] = []
    with Pool(given.processes) as pool:
        jobs = {
            place: [
                pool.apply_async(by_place, ((place, seed),))
                for seed in range(given.seeds * (SOUND if everything[place].group == "sound" else 1))
            ]
            for place in places
        }
        for place, waited in jobs.items():
            own = [one.get() for one in waited]
            rows += own
            print(line(everything[place].name, own), flush=True)
    if given.out is not None:
        given.out.parent.mkdir(parents=True, exist_ok=True)
        given.out.write_text(json.dumps(rows), encoding="utf-8")


def line(name: str, rows: list[dict[str, Any]]) -> str:
    """Return what came of a case in one line."""
    seen = [row for row in rows if not row["refused"]]
    refused = len(rows) - len(seen)
    if not seen:
        return f"{name:55s} refused: {rows[0]['said'][0][:100]}"
    error, u, cover = (float(np.median([row[key] for row in seen])) for key in ("error", "u", "cover"))
    large = [row for row in seen if row["shown"] and row["error"] > 3 * row["u"]]
    missed = sum(row["verdict"] == "fit for use" for row in large)
    doubted = sum(row["verdict"] != "fit for use" for row in seen)
    named = sum(bool(set(row["kinds"]) & set(row["expected"])) for row in seen)
    spent = float(np.median([row["seconds"] for row in seen]))
    kinds = sorted({kind for row in seen for kind in row["kinds"]})
    return (
        f"{name:55s} err {error:9.3g} u {u:9.3g} ratio {error / max(u, 1e-12):7.2f} cover {cover:.2f} "
        f"large {len(large):2d} missed {missed:2d} doubted {doubted:2d} named {named:2d} refused {refused} "
        f"{spent:5.2f} s {','.join(kinds)}"
    )


if __name__ == "__main__":
    main()
