"""The command compare on components that ring together: every rival on every component, in one table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from aerobalance.app.commands.compare import standings
from aerobalance.app.commands.loads import Source, loads_account
from aerobalance.app.commands.shared import Account, doubts
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.io import read
from aerobalance.io.dynamics_file import modes_payload
from aerobalance.recording.components import si_unit
from aerobalance.recording.errors import FitError
from aerobalance.validation.baselines import THIS
from aerobalance.validation.coupled_baselines import estimates_of_coupled, own_response
from aerobalance.validation.scores import END_SHARE, Truth, truth_on_clock


def compare_coupled(
    path: Path,
    dynamics: CoupledDynamics,
    *,
    source: Source,
    inputs: Sequence[Path],
    truth: Path | None,
    component: str | None,
    half_range: Mapping[str, float],
    out: Path | None,
) -> Account:
    """Every rival on every component of one record; the arguments are those of `aerobalance.app.commands.compare`."""
    names = dynamics.components if component is None else (component,)
    if not set(names) <= set(dynamics.components):
        raise FitError(f"the dynamics have no {component}; they have {', '.join(dynamics.components)}")
    lowest = dynamics.modes[0].natural_frequency
    with doubts() as collected:
        recording, reduced = source.with_loads(path)
        truths: dict[str, Truth] = {}
        if truth is not None:
            applied = read(truth)
            for name in names:
                values = truth_on_clock(recording, applied, name)
                truths[name] = Truth.of(values, rate=recording.rate, natural_frequency=lowest)
        found = estimates_of_coupled(
            recording, dynamics, components=tuple(names), gravity=source.gravity, truths=truths
        )
    account: Account = {
        "file": path.name,
        "modes": modes_payload(dynamics),
        "components": {
            name: {
                "unit": si_unit(name),
                **standings(rows, truths.get(name), half_range=half_range.get(name), unit=si_unit(name)),
            }
            for name, rows in found.items()
        },
        **({} if reduced is None else {"loads": loads_account(reduced)}),
        "warnings": collected,
    }
    account["table"] = table_of(account)
    account["table_holds"] = words_for_table(account)
    if out is not None:
        from aerobalance.app.reports.compare_report import write_coupled_comparison  # noqa: PLC0415 - plotting is slow

        balances = {name: own_response(dynamics, name) for name in names}
        write_coupled_comparison(
            out, account, found, recording=recording, balances=balances, truths=truths, inputs=inputs
        )
        account["written"] = out.name
    return {**account, "summary": summary(account)}


def table_of(account: Account) -> list[Account]:
    """One row per rival and setting, one number per component; what could not be run has a reason instead."""
    parts: Mapping[str, Account] = account["components"]
    order = dict.fromkeys((row["name"], row["setting"]) for part in parts.values() for row in part["rivals"])
    table = []
    for name, setting in order:
        numbers: dict[str, float] = {}
        reasons: dict[str, list[str]] = {}
        for component, part in parts.items():
            for row in part["rivals"]:
                if (row["name"], row["setting"]) != (name, setting):
                    continue
                if row["lacking"] is None:
                    numbers[component] = _judged_by(row)
                else:
                    reasons.setdefault(row["lacking"], []).append(component)
        table.append({"name": name, "setting": setting, "numbers": numbers, "not_run": reasons})
    return table


def _judged_by(row: Account) -> float:
    """What a row of one component puts into the table of all."""
    if "rms" not in row:
        return float(row["apart_from_this_estimator_rms"])
    share = float(row["percent_of_half_range"]["rms"])
    return share if np.isfinite(share) else float(row["rms"])


def words_for_table(account: Account) -> str:
    """What the numbers of the table are."""
    parts = list(account["components"].values())
    if parts[0]["half_range"] is None:
        return f"no truth given; rms difference from {THIS}, each in its own unit"
    if all(part["half_range"]["value"] > 0 for part in parts):
        said = ", ".join(dict.fromkeys(part["half_range"]["from"] for part in parts))
        return f"rms deviation from the truth in percent of half range ({said}), {100 * END_SHARE:g} % at each end out"
    return f"rms deviation from the truth, each in its own unit, {100 * END_SHARE:g} % at each end out"


def summary(account: Account) -> str:
    """Lay the comparison out as a table for people."""
    names = list(account["components"])
    rows = account["table"]
    keys = [f"{row['name']}{' *' if row['setting'] != 'customary' else ''}" for row in rows]
    width = max(len(key) for key in keys)
    modes = ", ".join(f"{mode['natural_frequency']:.4g}" for mode in account["modes"])
    lines = [f"{account['file']}: components that ring together, modes at {modes} Hz", account["table_holds"]]
    lines += ["*: its one tuning number chosen on the truth, which no user has", ""]
    lines += [" ".join([" " * width, *(f"{name:>9}" for name in names)])]
    for key, row in zip(keys, rows, strict=True):
        cells = (f"{row['numbers'][name]:.3g}" if name in row["numbers"] else "-" for name in names)
        lines.append(" ".join([f"{key:<{width}}", *(f"{cell:>9}" for cell in cells)]))
    lines += [""]
    for row in rows:
        lines += [f"{row['name']}, not run on {', '.join(some)}: {why}" for why, some in row["not_run"].items()]
    lines += [f"{name}, {text}" for name, part in account["components"].items() for text in part["verdict"][:1]]
    return "\n".join(lines).rstrip() + "\n"
