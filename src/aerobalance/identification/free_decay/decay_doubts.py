"""What a ringing record says against the dynamics that are found of it."""

from __future__ import annotations

from typing import Final

import numpy as np

from aerobalance.dynamics.single import Dynamics
from aerobalance.identification.free_decay.law import AmplitudeLaw
from aerobalance.identification.free_decay.waveform import Ring
from aerobalance.identification.free_decay.window import COLOURED, Account
from aerobalance.recording.components import driving_channel, si_unit
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import argument
from aerobalance.recording.noise import channel_noise
from aerobalance.recording.recording import Recording
from aerobalance.recording.wording import NOT_TOLD, damping_text

DOUBTFUL_DAMPING: Final = 0.1
"""Relative standard uncertainty of the damping above which it is called hardly identifiable."""

MOST_CHANGE: Final = 2.0
"""Change of frequency or damping with the amplitude, over their mean, above which no figure of it is told."""

MOVING: Final = 0.02
"""Load by the ground's motion, over the amplitude of the ringing, from which it counts."""


def doubts_of(found: Account, dynamics: Dynamics, recording: Recording, *, kept: list[int]) -> list[Doubt]:
    """Return what is doubted, with the effect of each on the damping, over it [1].

    Parameters
    ----------
    found
        What the record is made of.
    dynamics
        What is made of it.
    recording
        The record.
    kept
        Places in `Ring.lines` of the modes that are a part of the dynamics.
    """
    ring, name = found.ring, dynamics.component
    doubts: list[Doubt] = []

    def add(kind: str, text: str, advice: str = "", effect: float | None = None) -> None:
        doubts.append(Doubt(kind, name, text, advice, effect, "1"))

    for place, (line, size) in enumerate(zip(ring.lines, ring.line_sizes(), strict=True)):
        if line.decay > 0 and place not in kept:
            close = found.close and place == 0
            add(
                "close modes" if close else "missing mode",
                f"a further mode at {line.frequency:.4g} Hz, {_beside_the_first(size, ring)}, rings "
                "in the record; it is fitted beside the first one but is not part of the dynamics, so forces near "
                f"that frequency will be wrong ({_way_to_take_it_up(ring, place)})",
            )
    u = dynamics.uncertainty("damping")
    if u > DOUBTFUL_DAMPING * dynamics.damping:
        critical = 2 * dynamics.mass * 2 * np.pi * dynamics.natural_frequency
        add(
            "damping hardly told",
            f"the damping is hardly identifiable ({damping_text(dynamics.damping, u, critical=critical)}); forces at "
            "the natural frequency carry that much",
            effect=u / dynamics.damping,
        )
    colour = ring.colour if ring.force is None else ring.force.colour
    if colour > COLOURED:
        add(
            "unexplained",
            f"the residuals near {ring.frequency:.4g} Hz are {colour:.1f} times as strong as white noise; the "
            "uncertainties are enlarged accordingly",
        )
    if ring.force is not None and ring.force.acts:
        add(
            "driving force",
            f"a force of {np.sqrt(ring.force.density):.2g} {si_unit(name)} per root Hz near {ring.frequency:.4g} Hz "
            "acts while it rings, as wind does; the fit and its uncertainties count with it",
            "release it once more with the wind off",
            effect=0.0,
        )
    if found.broken:
        first, last = (recording.start + float(instant) for instant in ring.time[[0, -1]])
        add(
            "record cut",
            f"many readings are missing, and what drives the ringing is not followed over gaps; only the readings "
            f"from {first:.6g} s to {last:.6g} s are used",
            "release it once more and lose no readings",
            effect=0.0,
        )
    doubts += _cut(found, recording, name)
    doubts += _amplitude(found, name)
    doubts += _moving_ground(ring, dynamics, recording)
    return doubts


def notes_of(found: Account, recording: Recording) -> list[str]:
    """Return what a reader should know beside what is doubted."""
    ring = found.ring
    if ring.shape == "free" and ring.start > 0 and ring.force is None:
        text = (
            "the ringing is not that of a clean release from rest; its amplitude and phase are fitted freely, from "
            f"{recording.start + ring.start:.6g} s on"
        )
        return [text]
    return []


def _cut(found: Account, recording: Recording, name: str) -> list[Doubt]:
    """What is left out of a record, and why."""
    ring, (first, last) = found.ring, found.whole
    begin, end = float(ring.time[0]), float(ring.time[-1])
    early, late = ring.shape != "free" and begin - first > 0.5 / ring.rate, last - end > 0.5 / ring.rate
    if found.broken or not (early or late):
        return []
    parts = [
        f"{word} {recording.start + instant:.6g} s"
        for word, instant, there in (("before", begin, early), ("from", end, late))
        if there
    ]
    text = (
        f"the readings {' and '.join(parts)} on do not go with the ringing, as when something else happens; "
        if late and not early
        else f"the readings {' and '.join(parts)} do not go with the ringing, as when something else happens; "
    )
    text += (
        f"they are left out, and the {end - max(begin, ring.start):.4g} s of ringing that are used tell the damping "
        f"better than all {last - max(first, ring.start):.4g} s"
    )
    return [
        Doubt("record cut", name, text, "look what happens there, and record a release that nothing follows", 0.0, "1")
    ]


def _amplitude(found: Account, name: str) -> list[Doubt]:
    """What follows from a dependence on the amplitude."""
    dependence, law = found.dependence, found.law
    if dependence is None:
        return []
    texts = []
    over, counted = "from the smallest to the largest", "the mean is taken, and"
    if dependence.damping_depends:
        ratios = "" if law is None else f" (damping ratio {_at_two(law, name)})"
        texts.append(
            f"the damping of {name} depends on the amplitude: {_change(dependence.damping, dependence.u_damping)} "
            f"{over}{ratios}, as {_cause(found)} does; {counted} the difference is in its uncertainty"
        )
    if dependence.frequency_depends:
        texts.append(
            f"the frequency of {name} depends on the amplitude: "
            f"{_change(dependence.frequency, dependence.u_frequency)} {over}: the spring is not linear; "
            f"{counted} the difference is in the uncertainty of the stiffness"
        )
    advice = "release it with about the load that it is to measure"
    effect = 0.0 if law is not None else None
    return [Doubt("amplitude dependence", name, text, advice, effect, "1") for text in texts]


def _cause(found: Account) -> str:
    if found.law is None or found.law.powers.damping > 0:
        return "drag or a joint that slips"
    return "friction"


def _at_two(law: AmplitudeLaw, name: str) -> str:
    first, last = (
        f"{value:.3g} (u = {deviation:.1g}) at {amplitude:.3g} {si_unit(name)}"
        for value, deviation, amplitude in zip(law.damping_ratio, law.u_damping_ratio, law.amplitude, strict=True)
    )
    return f"{first}, {last}"


def _moving_ground(ring: Ring, dynamics: Dynamics, recording: Recording) -> list[Doubt]:
    """What the ground's motion after the release does."""
    name = driving_channel("ground", dynamics.component, recording)
    if name not in recording:
        return []
    ground = recording.channel(name)
    after = ground.values[max(int(np.ceil(ring.start * recording.rate)), 0) :]
    after = after[np.isfinite(after)]
    moving = np.sqrt(max(float(np.var(after)) - 1.25 * channel_noise(ground) ** 2, 0.0)) if after.size else 0.0
    if dynamics.mass * moving <= MOVING * abs(ring.amplitude):
        return []
    text = (
        f"the ground end moves after the release ({moving:.2g} m/s^2 rms, a load of "
        f"{dynamics.mass * moving:.3g} {si_unit(dynamics.component)}); the fit takes it at rest, so stiffness and "
        "damping are those of balance and support together"
    )
    return [
        Doubt("moving ground", dynamics.component, text, "hold the ground end, or shake it and use `rig`", None, "1")
    ]


def _beside_the_first(size: float, ring: Ring) -> str:
    """Return how strongly a further mode rings beside the first."""
    part = size / ring.amplitude if ring.amplitude else np.inf
    return f"{100 * part:.2g} % of the first" if part <= 1 else "as strong as the first or stronger"


def _way_to_take_it_up(ring: Ring, place: int) -> str:
    """Return which record or option makes a further mode part of the dynamics."""
    if ring.shape == "free":
        return f"a record of a clean release from rest tells its share of a load, with {argument('modes', 'auto')}"
    if place in possible_modes(ring, [place]):
        return f"{argument('modes', 'auto')} takes it up"
    return f"its share of a load {NOT_TOLD}: release at another place, or record for longer"


def _change(part: float, u: float) -> str:
    """Return a relative change in words; what is more than twice of what changes is told without a figure."""
    return f"{100 * part:+.2g} % (u = {100 * u:.1g} %)" if abs(part) <= MOST_CHANGE else "by more than itself"


def possible_modes(ring: Ring, places: list[int]) -> list[int]:
    """Those of some places in `Ring.lines` whose share of a load is less than the whole."""
    decaying = [place for place, line in enumerate(ring.lines) if line.decay > 0]
    heights = ring.modes()[0][:, 2]
    kept = list(places)
    while kept:
        own = heights[[1 + decaying.index(place) for place in kept]]
        if np.abs(own).max() < abs(heights[0] + own.sum()):
            break
        kept.pop(int(np.argmax(np.abs(own))))
    return kept
