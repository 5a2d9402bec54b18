"""What the command force says of the uncertainty: numbers that sum up the force, the budget, and Monte Carlo."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aerobalance.commands.shared import Account, table_text
from aerobalance.components import si_unit
from aerobalance.estimate import ForceEstimate
from aerobalance.monte_carlo import Compared, MonteCarlo
from aerobalance.recording import Recording
from aerobalance.uncertainty import advice, budget, scalars, spectrum

NAMES = {
    "mean": "mean",
    "rms_about_mean": "rms about the mean",
    "largest": "force where it is largest",
    "least": "force where it is least",
    "largest_in_record": "largest in the record",
    "least_in_record": "least in the record",
}


@dataclass(frozen=True, slots=True)
class Origins:
    """Where contributions come from: the files beside the recording.

    Attributes
    ----------
    recording
        The recording whose channels are meant.
    dynamics
        File of the dynamics.
    balance
        File of the balance matrix, where there is one.
    """

    recording: Recording
    dynamics: Path
    balance: Path | None = None

    def of(self, source: str, name: str = "") -> str:
        """Where a contribution comes from, for a reader."""
        if source == "dynamics":
            return self.dynamics.name
        if source == "balance" and self.balance is not None:
            return self.balance.name
        channels = [part for part in source.split(" and ") if part in self.recording]
        if not channels:
            return source
        known = [self.recording.channel(part).noise is not None for part in channels]
        how = "" if not name.startswith("noise") else ", as given" if all(known) else ", judged from the record"
        return f"{' and '.join(channels)}{how}"


def scalar_account(estimate: ForceEstimate, recording: Recording) -> Account:
    """Mean, rms about it and extremes of a force, with their standard uncertainties."""
    found = {item.name: item for item in scalars(estimate)}
    account: Account = {}
    for name, item in found.items():
        account[name], account[f"u_{name}"] = item.value, item.u
    for name, place in (("largest", np.argmax(estimate.values)), ("least", np.argmin(estimate.values))):
        account[f"instant_of_{name}"] = float(recording.start + place / recording.rate)
    return account


def budget_account(estimate: ForceEstimate, origins: Origins) -> Account:
    """Uncertainty budget, what to improve first, and the spectrum with its uncertainty."""
    unit = si_unit(estimate.component)
    rows = [
        {
            "name": row.name,
            "from": origins.of(row.source, row.name),
            "rms": row.rms,
            "share": row.share,
            "rms_of_all_if_halved": row.if_halved,
            **{f"u_{name}": value for name, value in row.scalars.items()},
        }
        for row in budget(estimate)
    ]
    found = spectrum(estimate, rate=origins.recording.rate)
    files = {part.source: origins.of(part.source) for part in estimate.contributions}
    sentence = advice(estimate, unit=unit, sources=files)
    return {
        "budget": rows,
        "improve_first": sentence,
        "spectrum": {
            "unit": f"{unit}^2/Hz",
            "frequency_unit": "Hz",
            "frequency": found.frequency.tolist(),
            "density": found.density.tolist(),
            "u_scatter": found.scatter.tolist(),
            "u_force": found.uncertainty.tolist(),
        },
    }


def monte_carlo_account(found: MonteCarlo) -> Account:
    """Plain data on a Monte Carlo check."""

    def row(item: Compared) -> Account:
        known = bool(np.isfinite(item.analytic))
        return {
            "monte_carlo": item.drawn,
            "first_order": item.analytic if known else None,
            "ratio": item.ratio if known and np.isfinite(item.ratio) else None,
            "u_ratio": item.scatter,
            **({"interval_95": list(item.interval)} if item.interval else {}),
        }

    return {
        "draws": found.draws,
        "seed": found.seed,
        "contributions": {item.name: row(item) for item in found.contributions},
        "scalars": {item.name: row(item) for item in found.scalars},
        "doubts": list(found.doubts),
    }


def uncertainty_text(components: Mapping[str, Account]) -> str:
    """Tables for people: the budget of every component, and Monte Carlo beside it where it was run."""
    texts = []
    for name, account in components.items():
        unit = account["unit"]
        title = f"uncertainty budget of {name} [{unit}]"
        rows = [
            [row["name"], row["from"], f"{row['rms']:.3g}", f"{100 * row['share']:.1f}", f"{row['u_mean']:.3g}"]
            for row in account["budget"]
        ]
        texts.append(table_text(title, ["contribution", "from", "rms", "% of variance", "in the mean"], rows))
        if "monte_carlo" in account:
            found = account["monte_carlo"]
            title = (
                f"Monte Carlo of {name}, {found['draws']} draws, seed {found['seed']}: standard uncertainty [{unit}]"
            )
            lines = {**found["contributions"], **{NAMES[key]: row for key, row in found["scalars"].items()}}
            rows = [
                [key, *(_cell(row[which]) for which in ("monte_carlo", "first_order", "ratio", "u_ratio"))]
                for key, row in lines.items()
            ]
            texts.append(table_text(title, ["", "Monte Carlo", "first order", "ratio", "u(ratio)"], rows))
    return "\n" + "\n\n".join(texts)


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
