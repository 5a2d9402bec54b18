"""The command plan: what a test can reach, before it is made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from aerobalance.app.commands.shared import Account, doubts, table_text
from aerobalance.dynamics.single import Dynamics
from aerobalance.io.coupled_file import dynamics_kind, read_coupled
from aerobalance.io.dynamics_file import read_dynamics
from aerobalance.recording.components import si_unit
from aerobalance.uncertainty.coupled_planning import Sensors
from aerobalance.uncertainty.planning import Attainable, attainable, live_lag, usual_bandwidths

QUIETER: Final = "a quieter amplifier, more excitation or a higher sampling rate"
"""What helps against the noise of a reading."""

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
) -> Account:
    """Attainable uncertainty against bandwidth and sampling rate.

    `turn_noise`, and noise and force by component, are for components that ring together.
    """
    if not 0 < rate < float("inf"):
        raise ValueError(f"--rate must be positive, not {rate:g}")
    if dynamics_kind(dynamics) == "coupled":
        from aerobalance.app.commands.plan_coupled import plan_coupled  # noqa: PLC0415 - it takes parts of this

        if not isinstance(noise, Mapping) or not (force is None or isinstance(force, Mapping)):
            raise ValueError("the components ring together: give --noise and --force by component, NF=0.5 and so on")
        return plan_coupled(
            read_coupled(dynamics),
            Sensors(noise, acceleration_noise, turn_noise),
            rate=rate,
            component=component,
            force=force,
            bandwidths=bandwidths,
        )
    known = read_dynamics(dynamics)
    if component is None:
        if len(known) > 1:
            raise ValueError(f"{dynamics} has {', '.join(known)}; name one with --component")
        component = next(iter(known))
    if component not in known:
        raise ValueError(f"{dynamics} has no {component}; it has {', '.join(known)}")
    return _plan_one(
        known[component],
        rate=rate,
        noise=_own(noise, component, "--noise"),
        acceleration_noise=acceleration_noise,
        force=None if force is None else _own(force, component, "--force"),
        bandwidths=bandwidths,
    )


def _plan_one(
    chosen: Dynamics,
    *,
    rate: float,
    noise: float,
    acceleration_noise: float,
    force: float | None,
    bandwidths: Sequence[float],
) -> Account:
    """Attainable uncertainty of a component that rings for itself."""
    sensors = {"noise": noise, "acceleration_noise": acceleration_noise, "force": force}
    with doubts() as collected:
        rows = [
            attainable(chosen, bandwidth=bandwidth, rate=rate, **sensors)  # type: ignore[arg-type]
            for bandwidth in (bandwidths or usual_bandwidths(chosen, rate))
        ]
        faster = [
            attainable(chosen, bandwidth=_edge(chosen, rate), rate=factor * rate, **sensors)  # type: ignore[arg-type]
            for factor in (1, 2, 4, 8)
        ]
    account: Account = {
        "component": chosen.component,
        "unit": si_unit(chosen.component),
        "natural_frequency": {"value": chosen.natural_frequency, "unit": "Hz"},
        "further_natural_frequencies": [mode.natural_frequency for mode in chosen.further_modes],
        "rate": rate,
        "noise_of_reading": noise,
        "noise_of_acceleration": acceleration_noise,
        "force_rms": force,
        "attainable": [_row(row) for row in rows],
        "at_other_rates": [
            {"rate": factor * rate, **_row(row)} for factor, row in zip((1, 2, 4, 8), faster, strict=True)
        ],
        "live_lag": {"value": live_lag(chosen), "unit": "s"},
        "advice": _advice(faster[0], chosen, force),
        "warnings": collected,
    }
    return {**account, "summary": _summary(account)}


def _own(amount: Amount, component: str, option: str) -> float:
    """The number for one component."""
    if not isinstance(amount, Mapping):
        return amount
    if component not in amount:
        raise ValueError(f"{option} is given for {', '.join(amount)}, not for {component}")
    return amount[component]


def _edge(dynamics: Dynamics, rate: float) -> float:
    """Bandwidth at which sampling rates are compared: through resonance, where the rate allows it."""
    return min(1.25 * dynamics.natural_frequency, rate / 2)


def _row(row: Attainable) -> Account:
    return {
        "bandwidth": row.bandwidth,
        "u": row.total,
        "u_reading": row.reading,
        "u_acceleration": row.acceleration,
        "u_parameters": row.parameters,
        "noise_gain": row.noise_gain,
        "limited_by": row.limited_by,
    }


def _advice(row: Attainable, dynamics: Dynamics, force: float | None) -> str:
    """Say what to improve first."""
    improve = {
        "noise of the balance reading": QUIETER,
        "noise of the ground accelerometer": "a quieter accelerometer on the ground end (or a stiffer support)",
        "mass, stiffness, damping, delay": "weighing and identification: a longer record, or several releases",
    }[row.limited_by]
    text = f"up to {row.bandwidth:.4g} Hz the limit is the {row.limited_by}: {improve}"
    if force is None and dynamics.covariance.any():
        text += ". Give --force to see what mass, stiffness and damping add"
    return text


def _summary(account: Account) -> str:
    unit = account["unit"]
    others = ", ".join(f"{frequency:.5g}" for frequency in account["further_natural_frequencies"])
    further = f" (further modes {others} Hz)" if others else ""
    table = table_text(
        f"{account['component']}: standard uncertainty of one sample, f0 = "
        f"{account['natural_frequency']['value']:.5g} Hz{further}, {account['rate']:.5g} Hz",
        ("bandwidth", "u", "reading", "accelerometer", "parameters", "noise gain", "limited by"),
        [("Hz", unit, unit, unit, unit, "", "")]
        + [
            (
                f"{row['bandwidth']:.4g}",
                *(f"{row[key]:.3g}" for key in ("u", "u_reading", "u_acceleration", "u_parameters", "noise_gain")),
                row["limited_by"],
            )
            for row in account["attainable"]
        ],
    )
    rates = table_text(
        f"up to {account['at_other_rates'][0]['bandwidth']:.4g} Hz, sampled faster at the same noise per sample",
        ("rate", "u", "limited by"),
        [("Hz", unit, "")]
        + [(f"{row['rate']:.5g}", f"{row['u']:.3g}", row["limited_by"]) for row in account["at_other_rates"]],
    )
    lag = f"live, the force follows {1e3 * account['live_lag']['value']:.3g} ms behind"
    return "\n".join([table, "", rates, "", lag, account["advice"], ""])
