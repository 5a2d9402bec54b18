"""What the page says of how far a live force can be trusted."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from aerobalance.estimation.live.health import SHORTEST
from aerobalance.estimation.live.live_force import LiveForce
from aerobalance.recording.channel import Array
from aerobalance.recording.doubts import Size, verdict_of


def is_still(values: Array) -> bool:
    """Return whether readings, shape (n,), are one number all along; few readings tell nothing."""
    known = values[np.isfinite(values)]
    return known.size >= SHORTEST and bool((known == known[0]).all())


def verdict_on(live: LiveForce, name: str, parts: list[Array], *, still: bool) -> dict[str, object]:
    """Return whether the force of a component may be used now, and what speaks against it, as plain data.

    Parameters
    ----------
    live
        What works the force out.
    name
        The component.
    parts
        The last samples of its force with their standard uncertainty, shape (m, 2) each [N, N*m].
    still
        Whether its readings have not changed meanwhile.
    """
    health = live.health.get(name)
    pair = np.concatenate(parts) if parts else np.zeros((0, 2))
    known = pair[np.isfinite(pair).all(axis=1)]
    if health is None or not known.size:
        return {}
    u = float(np.sqrt(np.mean(known[:, 1] ** 2)))
    size = Size(u, float(np.std(known[:, 0])), float(np.mean(known[:, 0])))
    doubts = health.doubts(name, uncertainty=u, still=still)
    return {"verdict": str(verdict_of(doubts, {name: size})), "doubts": [asdict(doubt) for doubt in doubts]}


def health_of(live: LiveForce, name: str) -> dict[str, object]:
    """Return how far the force of a component can be trusted, as plain data."""
    health = live.health.get(name)
    told: dict[str, object] = {"lag": live.lag, "rate": 1 / live.interval, "moving": live.moving}
    if health is None:
        return told | {"process": "waiting"}
    low, high = health.resonance_limits
    return told | {
        "process": health.process,
        "explained": health.explained,
        "drifted": health.drifted,
        "mean_square": health.mean_square,
        "mean_square_limit": health.mean_square_limit,
        "resonance": health.resonance,
        "resonance_limits": [low, high],
        "noise": health.noise,
        "noise_now": health.noise_now,
        "missing": health.missing,
    }
