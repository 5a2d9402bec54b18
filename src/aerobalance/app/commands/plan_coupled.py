"""The command plan on components that ring together: which sensor limits which component."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from aerobalance.app.commands.plan import QUIETER
from aerobalance.app.commands.shared import Account, doubts, table_text
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.io.coupled_file import modes_payload
from aerobalance.recording.components import si_unit
from aerobalance.recording.errors import FitError
from aerobalance.uncertainty.coupled_planning import (
    GROUND,
    PARAMETERS,
    CoupledAttainable,
    Sensors,
    attainable_coupled,
    usual_bandwidths_of_coupled,
)


def plan_coupled(
    dynamics: CoupledDynamics,
    sensors: Sensors,
    *,
    rate: float,
    component: str | None,
    force: Mapping[str, float] | None,
    bandwidths: Sequence[float],
) -> Account:
    """Attainable uncertainty of every component, or of one; the arguments are those of `commands.plan`."""
    names = dynamics.components if component is None else (component,)
    if not set(names) <= set(dynamics.components):
        raise FitError(f"the dynamics have no {component}; they have {', '.join(dynamics.components)}")
    edge = min(1.25 * max(mode.natural_frequency for mode in dynamics.modes), rate / 2)
    with doubts() as collected:
        rows = [
            attainable_coupled(dynamics, sensors, bandwidth=bandwidth, rate=rate, force=force)
            for bandwidth in (bandwidths or usual_bandwidths_of_coupled(dynamics, rate))
        ]
        faster = {
            factor: attainable_coupled(dynamics, sensors, bandwidth=edge, rate=factor * rate, force=force)
            for factor in (1, 2, 4, 8)
        }
    parts: dict[str, Account] = {}
    for place, name in enumerate(dynamics.components):
        if name not in names:
            continue
        parts[name] = {
            "unit": si_unit(name),
            "noise_of_reading": sensors.noise[name],
            "force_rms": None if force is None else force[name],
            "attainable": [_row(row[place]) for row in rows],
            "at_other_rates": [{"rate": factor * rate, **_row(row[place])} for factor, row in faster.items()],
            "advice": _advice(faster[1][place], dynamics, force),
        }
    account: Account = {
        "modes": modes_payload(dynamics),
        "rate": rate,
        "noise_of_acceleration": sensors.acceleration,
        "noise_of_turning": sensors.turning,
        "components": parts,
        "warnings": collected,
    }
    return {**account, "summary": _summary(account)}


def _row(row: CoupledAttainable) -> Account:
    return {
        "bandwidth": row.bandwidth,
        "u": row.total,
        "u_taken_apart": row.apart,
        "u_by_sensor": dict(row.sensors),
        "u_parameters": row.parameters,
        "noise_gain": row.noise_gain,
        "limited_by": row.limited_by,
    }


def _advice(row: CoupledAttainable, dynamics: CoupledDynamics, force: Mapping[str, float] | None) -> str:
    """Say what to improve first."""
    improve = {
        GROUND[0]: "quieter accelerometers on the ground end (or a stiffer support)",
        GROUND[1]: "a quieter sensor of the ground end's turning, or accelerometers farther apart",
        PARAMETERS: "identification: more releases, or larger ones",
    }.get(row.limited_by, QUIETER)
    text = f"{row.component} up to {row.bandwidth:.4g} Hz: the limit is {row.limited_by}: {improve}"
    if force is None and dynamics.covariance.any():
        text += ". Give --force to see what inertia and damping add"
    return text


def _summary(account: Account) -> str:
    modes = ", ".join(f"{mode['natural_frequency']:.4g}" for mode in account["modes"])
    parts: Mapping[str, Account] = account["components"]
    texts = [f"components that ring together, modes at {modes} Hz, {account['rate']:.5g} Hz"]
    for name, part in parts.items():
        unit = part["unit"]
        table = table_text(
            f"{name}: standard uncertainty of one sample",
            ("bandwidth", "u", "taken apart", "parameters", "noise gain", "limited by"),
            [("Hz", unit, unit, unit, "", "")]
            + [
                (
                    f"{row['bandwidth']:.4g}",
                    *(f"{row[key]:.3g}" for key in ("u", "u_taken_apart", "u_parameters", "noise_gain")),
                    f"{row['limited_by']}, {row['u_by_sensor'].get(row['limited_by'], row['u_parameters']):.3g}",
                )
                for row in part["attainable"]
            ],
        )
        texts += ["", table]
    rates = [row["rate"] for row in next(iter(parts.values()))["at_other_rates"]]
    edge = next(iter(parts.values()))["at_other_rates"][0]["bandwidth"]
    texts += [
        "",
        table_text(
            f"u up to {edge:.4g} Hz, sampled faster at the same noise per sample",
            ("", *(f"{rate:.5g} Hz" for rate in rates)),
            [
                (f"{name} [{part['unit']}]", *(f"{row['u']:.3g}" for row in part["at_other_rates"]))
                for name, part in parts.items()
            ],
        ),
        "",
        *(part["advice"] for part in parts.values()),
        "",
    ]
    return "\n".join(texts)
