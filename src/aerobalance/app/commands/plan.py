"""The command plan: what a test can reach, before it is made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from aerobalance.app.commands.shared import Result, collected_warnings, table_text
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.io.coupled_part import modes_payload
from aerobalance.io.dynamics_file import read_any_dynamics
from aerobalance.uncertainty.planning import ComponentPlan, Plan
from aerobalance.uncertainty.planning import plan as plan_test
from aerobalance.uncertainty.wiener_bound import Attainable

Amount = float | Mapping[str, float]
"""One number, or one for each component."""


def plan(
    dynamics: Path,
    *,
    noise: Amount,
    rate: float,
    component: str | None = None,
    acceleration_noise: float = 0.0,
    turn_noise: float = 0.0,
    force: Amount | None = None,
    bandwidths: Sequence[float] = (),
) -> Result:
    """Attainable uncertainty against bandwidth and sampling rate, of every component or of one."""
    known = read_any_dynamics(dynamics)
    if component is not None and component not in known.components:
        raise ValueError(f"{dynamics} has no {component}; it has {', '.join(known.components)}")
    if component is not None:
        known = known.block_of(component)
    with collected_warnings() as collected:
        found = plan_test(
            known,
            rate=rate,
            noise=noise,
            acceleration_noise=acceleration_noise,
            angular_acceleration_noise=turn_noise,
            force=force,
            bandwidths=bandwidths,
        )
    coupled = known if isinstance(known, CoupledDynamics) else None
    parts = [part for name, part in found.components.items() if component in (None, name)]
    accounts = {part.component: _part(part, found, coupled=coupled is not None) for part in parts}
    result: Result = {
        **({} if coupled is None else {"modes": modes_payload(coupled)}),
        **({"components": accounts} if coupled is not None or len(parts) > 1 else accounts[parts[0].component]),
        "warnings": collected,
    }
    return {**result, "summary": _summary(parts, found, coupled=coupled is not None)}


def _part(part: ComponentPlan, whole: Plan, *, coupled: bool) -> Result:
    """Plain data on one component."""
    frequencies: Result = {}
    if not coupled:  # the modes of coupled components belong to all of them
        first, *further = part.natural_frequencies
        frequencies = {
            "natural_frequency": {"value": first, "unit": "Hz"},
            "further_natural_frequencies": further,
        }
    return {
        "component": part.component,
        "unit": part.unit,
        **frequencies,
        "rate": whole.rate,
        "noise_of_reading": part.noise,
        "noise_of_acceleration": whole.acceleration_noise,
        **({"noise_of_angular_acceleration": whole.angular_acceleration_noise} if coupled else {}),
        "force_rms": part.force,
        "attainable": [_row(row, coupled=coupled) for row in part.table],
        "at_other_rates": [{"rate": row.rate, **_row(row, coupled=coupled)} for row in part.at_other_rates],
        "live_lag": {"value": part.live_lag, "unit": "s"},
        "advice": _advice(part, whole),
    }


def _row(row: Attainable, *, coupled: bool) -> Result:
    """Plain data on one line; what only coupled components have stands behind the reading of the component itself."""
    others = {name: u for name, u in row.readings.items() if name != row.component}
    more = {
        "u_other_readings": others,
        "u_angular_acceleration": row.angular_acceleration,
        "u_decoupled": row.decoupled,
    }
    return {
        "bandwidth": row.bandwidth,
        "u": row.total,
        "u_reading": row.readings[row.component],
        "u_acceleration": row.acceleration,
        **(more if coupled else {}),
        "u_parameters": row.parameters,
        "noise_gain": row.noise_gain,
        "limited_by": row.limited_by,
    }


def _advice(part: ComponentPlan, whole: Plan) -> str:
    """Return what to improve first, and which option would tell more."""
    hint = ". Give --force to see what the uncertainty of the dynamics adds" if whole.parameters_left_out else ""
    return part.advice + hint


def _summary(parts: Sequence[ComponentPlan], whole: Plan, *, coupled: bool) -> str:
    texts = []
    if coupled:
        texts += [f"coupled components, modes at {_listed(parts[0].natural_frequencies)} Hz, {whole.rate:.5g} Hz", ""]
    for part in parts:
        title = f"{part.component}: standard uncertainty of one sample"
        if not coupled:
            first, *further = part.natural_frequencies
            modes = f" (further modes {_listed(further)} Hz)" if further else ""
            title += f", f0 = {first:.5g} Hz{modes}, {whole.rate:.5g} Hz"
        texts += [_table(part, title, coupled=coupled), ""]
    lags = [f"{1e3 * part.live_lag:.3g} ms" + (f" ({part.component})" if len(parts) > 1 else "") for part in parts]
    rates = table_text(
        "u through resonance, sampled faster at the same noise per sample",
        ("", "up to", *(f"{row.rate:.5g} Hz" for row in parts[0].at_other_rates)),
        [
            (
                f"{part.component} [{part.unit}]",
                f"{part.at_other_rates[0].bandwidth:.4g} Hz",
                *(f"{row.total:.3g}" for row in part.at_other_rates),
            )
            for part in parts
        ],
    )
    live = f"live, the force follows {', '.join(lags)} behind"
    return "\n".join([*texts, rates, "", live, *(_advice(part, whole) for part in parts), ""])


def _table(part: ComponentPlan, title: str, *, coupled: bool) -> str:
    """The attainable uncertainty of one component against bandwidth."""
    decoupled = ("decoupled",) if coupled else ()
    headings = ("bandwidth", "u", *decoupled, "readings", "ground end", "parameters", "noise gain", "limited by")
    units = ("Hz", *(part.unit for _ in headings[1:-2]), "", "")
    rows = []
    for row in part.table:
        readings = float(np.linalg.norm(list(row.readings.values())))
        ground = float(np.hypot(row.acceleration, row.angular_acceleration))
        sizes = (row.total, *((row.decoupled,) if coupled else ()), readings, ground, row.parameters, row.noise_gain)
        largest = row.contributions[row.limited_by]
        cells = (f"{row.bandwidth:.4g}", *(f"{size:.3g}" for size in sizes), f"{row.limited_by}, {largest:.3g}")
        rows.append(cells)
    return table_text(title, headings, [units, *rows])


def _listed(frequencies: Sequence[float]) -> str:
    return ", ".join(f"{frequency:.5g}" for frequency in frequencies)
