"""Records that are wrong in one thing each, and sound ones: what was done to them, and what should be said of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.modal import Mode
from aerobalance.dynamics.single import Dynamics
from aerobalance.recording.components import COMPONENTS
from faults.scene import (
    DAMPING,
    FREQUENCY,
    LEAD,
    MASS,
    RATIO,
    STIFFNESS,
    Array,
    Clock,
    Maker,
    Modes,
    Record,
    Scene,
    band,
    constant,
    level,
    pieces,
    shaped,
    soft,
    step,
    together,
)
from faults.six import HIGHEST, SIX, SixScene, drawn, moved

Change = Callable[[Record, np.random.Generator], Record]
"""What is done to the readings."""


Color = Callable[[Array, float], Array]
"""Mean density of a noise about frequencies [Hz] over a width [Hz], [N^2/Hz]."""


@dataclass(frozen=True)
class Case:
    """A kind of record.

    Attributes
    ----------
    name, group
        What it is called, and under which subject.
    scene
        How the record is made.
    kinds
        Kinds of doubt of which one names the fault rightly; none for a sound record.
    change
        What is done to the readings afterwards.
    dynamics
        The dynamics that the force is worked out with; for six components what makes them of those identified.
    settings
        How it is worked out.
    shown
        Whether the record can show the fault; what it cannot show is an assumption.
    own
        The balance's own dynamics, where the fault is that the force is worked out with others: the readings decide
        then whether they can show it.
    since
        Share of the record after which it shows the balance's own dynamics.
    color
        Density of the noise that is there beside the white, two-sided, its mean about frequencies [Hz] over a width
        [Hz], [N^2/Hz]: the readings decide then whether they can show it.
    right
        The scene with channels of the ground's motion that are right, where these are at fault: the readings decide
        then whether they can show it.
    calm
        How a record of noise alone is made, which the force is worked out with; None for none.
    """

    name: str
    group: str
    scene: Scene | SixScene
    kinds: tuple[str, ...] = ()
    change: Change | None = None
    dynamics: Dynamics | Callable[[CoupledDynamics], CoupledDynamics] = field(default_factory=lambda: dynamics())  # noqa: PLW0108 - defined below
    settings: dict[str, Any] = field(default_factory=dict)
    shown: bool = True
    own: Dynamics | None = None
    since: float = 0.0
    color: Color | None = None
    right: Scene | None = None
    calm: Scene | None = None

    def record(self, seed: int, *, right: bool = False) -> Record:
        """Return the record of a seed; the same with the channels of the ground's motion right, if so asked."""
        rng = np.random.default_rng([seed, *self.name.encode()])
        scene = self.right if right and self.right is not None else self.scene
        made = scene.record(rng)
        return made if self.change is None else self.change(made, rng)

    def noise_alone(self, seed: int) -> Record | None:
        """Return the record of noise alone of a seed."""
        return None if self.calm is None else self.calm.record(np.random.default_rng([seed, 7, *self.name.encode()]))

    def known(self, seed: int) -> Dynamics | CoupledDynamics:
        """Return the dynamics that the force of a seed is worked out with; of six components as releases give them."""
        if isinstance(self.dynamics, Dynamics):
            return self.dynamics
        return self.dynamics(drawn(np.random.default_rng([seed, 6])))


def dynamics(
    *, frequency: float = FREQUENCY, ratio: float = RATIO, mass: float = MASS, modes: tuple[Mode, ...] = ()
) -> Dynamics:
    """Return the dynamics of the balance as a good release gives them: frequency to 2e-5, damping to 0.3 %."""
    relative = np.array([2e-4, 2e-5, 3e-3])  # mass, natural frequency, damping ratio
    stiffness = mass * (2 * np.pi * frequency) ** 2
    damping = 2 * ratio * np.sqrt(stiffness * mass)
    slopes = np.array([[1.0, 0.0, 0.0], [1.0, 2.0, 0.0], [1.0, 1.0, 1.0]]) * relative
    size = 4 + 3 * len(modes)
    covariance = np.zeros((size, size))
    covariance[:3, :3] = slopes @ slopes.T * np.outer((mass, stiffness, damping), (mass, stiffness, damping))
    return Dynamics("AF", mass, stiffness, damping, covariance=covariance, further_modes=modes)


def changed(*, mass: float = 1.0, stiffness: float = 1.0, damping: float = 1.0) -> Dynamics:
    """Return dynamics with mass, stiffness and damping wrong by these factors."""
    m, k, b = MASS * mass, STIFFNESS * stiffness, DAMPING * damping
    return dynamics(frequency=float(np.sqrt(k / m) / (2 * np.pi)), ratio=b / (2 * np.sqrt(k * m)), mass=m)


BROAD = band(200.0, 0, 100)
SLOW = band(60.0, 0, 20)
MIDDLE = band(60.0, 0, 60)
STEP = together(step(500.0), band(12.0, 0, 30))
SOFT = soft(100.0, 30.0)
LOADS: dict[str, Maker] = {"broad": BROAD, "slow": SLOW, "step": STEP, "soft": SOFT}
LONG = Clock(samples=16000)
GROUND = band(2.0, 5, 100)


def all_cases() -> list[Case]:
    """Return all cases, the sound ones first."""
    return [*sound(), *wrong()]


def wrong() -> list[Case]:
    """Return the cases that are wrong in something."""
    makers = (
        wrong_dynamics,
        on_the_way,
        missing_modes,
        bent_springs,
        ground_channels,
        wild_samples,
        limited_channels,
        faint_forces,
        colors_of_noise,
        loads_that_change,
        oversampled,
        filters_not_told,
        clocks,
        direct_inverses,
        six_components,
    )
    return [one for make in makers for one in make()]


def rotor(rate: float) -> Maker:
    """Eight harmonics of a rotor, of 100 N over their number, in phases of their own."""
    numbers = np.arange(1, 9)

    def force(time: Array) -> Array:
        return np.sin(2 * np.pi * rate * np.multiply.outer(time, numbers) + 1.7 * numbers**2) @ (100 / numbers)

    return shaped(force)


def drifting_rotor(rate: float, drift: float) -> Maker:
    """Harmonics of a rotor as of `rotor`, whose speed grows by so much along the record [1], of any phases."""

    def made(clock: Clock, rng: np.random.Generator) -> Array:
        phases = rng.uniform(0, 2 * np.pi, 8)

        def force(time: Array) -> Array:
            turns = rate * (time + drift * time**2 / (2 * clock.end))
            numbers = np.arange(1, 9)
            return np.sin(2 * np.pi * np.multiply.outer(turns, numbers) + phases) @ (100 / numbers)

        return shaped(force)(clock, rng)

    return made


def wandering(first: float, last: float) -> Maker:
    """A tone of 10 N of a vortex: its frequency goes from one to another [Hz]; it and the size wander."""

    def made(clock: Clock, rng: np.random.Generator) -> Array:
        place = (clock.time + LEAD) / (clock.end + LEAD)
        frequency = first + (last - first) * np.minimum(place, 1) + 0.4 * band(1.0, 0, 2)(clock, rng)
        tone = np.sin(2 * np.pi * np.cumsum(frequency) * clock.interval) * (1 + 0.2 * band(1.0, 0, 1.5)(clock, rng))
        return shaped(lambda _: 10 * tone)(clock, rng)

    return made


def sound() -> list[Case]:
    """Return records with nothing wrong."""
    kinds: dict[str, Maker] = {
        "0-100 Hz, 200 N": BROAD,
        "0-20 Hz, 60 N": SLOW,
        "0-60 Hz, 60 N": MIDDLE,
        "soft 30 Hz, 100 N": soft(100.0, 30.0),
        "soft 10 Hz second order, 100 N": soft(100.0, 10.0, 2.0),
        "step": STEP,
        "step alone": step(1000.0),
        "two steps": together(step(400.0, at=0.7), step(-300.0, at=1.7), band(5.0, 0, 20)),
        "constant": constant(300.0),
        "faint 2 N": band(2.0, 0, 40),
        "narrow at 66 Hz": band(5.0, 60, 72),
        "narrow at 40 Hz": together(band(20.0, 37, 43), band(10.0, 0, 15)),
        "narrow at 67 Hz, 60 N": band(60.0, 66.75, 67.25),
        "narrow at 72 Hz, 60 N, and 0-60 Hz, 20 N": together(band(60.0, 71.3, 73.3), band(20.0, 0, 60)),
        "narrow at 70 Hz, 20 N, and 0-120 Hz, 60 N": together(band(20.0, 69.0, 71.0), band(60.0, 0, 120)),
        "sine 17 Hz": together(shaped(lambda t: 40 * np.sin(2 * np.pi * 17.3 * t)), band(10.0, 0, 30)),
        "sine 160 Hz, 20 N, and 0-30 Hz": together(
            shaped(lambda t: 20 * np.sin(2 * np.pi * 160.3 * t)), band(10.0, 0, 30)
        ),
        "rotor of 7.3 Hz": rotor(7.3),
        "rotor of 23 Hz": rotor(23.0),
        "rotor of 23 Hz and 0-60 Hz, 60 N": together(rotor(23.0), band(60.0, 0, 60)),
        "rotor of 13.7 Hz that drifts by 0.03 %": drifting_rotor(13.7, 3.3e-4),
        "rotor of 23 Hz that drifts by 1 %": drifting_rotor(23.0, 0.01),
        "tone that wanders from 60 to 63 Hz": wandering(60.0, 63.0),
        "tone that wanders from 69.7 to 71 Hz": wandering(69.7, 71.0),
        "triangle of 4 Hz, 300 N": shaped(lambda t: 300 * (2 / np.pi) * np.arcsin(np.sin(8 * np.pi * t))),
        "trapezoid of 3000 N": shaped(lambda t: 3000 * np.interp(t, [0.3, 0.7, 1.5, 2.1], [0, 1, 1, 0])),
    }
    found = [Case(name, "sound", Scene(force)) for name, force in kinds.items()]
    # long ones also of loads with edges, lines and steps: the local fit of a further mode is of these alone
    long = ("0-100 Hz, 200 N", "soft 30 Hz, 100 N", "step", "narrow at 40 Hz")
    long += ("0-60 Hz, 60 N", "narrow at 66 Hz", "sine 17 Hz", "two steps")
    long += tuple(name for name in kinds if "drifts" in name or "wanders" in name)
    found += [Case(f"{name}, 10 s", "sound", Scene(kinds[name], LONG)) for name in long]
    for name in ("0-100 Hz, 200 N", "step", "soft 30 Hz, 100 N"):
        force = kinds[name]
        found += [
            Case(f"{name}, shaken", "sound", Scene(force, ground=GROUND)),
            Case(f"{name}, shaken faintly", "sound", Scene(force, ground=band(0.05, 5, 100))),
            Case(f"{name}, pitching", "sound", Scene(force, pitch=band(0.02, 0, 3))),
            Case(f"{name}, 20 bit", "sound", Scene(force), change=partial(quantized, step=0.01)),
            Case(f"{name}, a short gap", "sound", Scene(force), change=partial(with_gap, seconds=0.01)),
            Case(f"{name}, 0.6 s", "sound", Scene(force, Clock(samples=960))),
            Case(f"{name}, 400 Hz", "sound", Scene(force, Clock(rate=400.0, samples=1000))),
            Case(f"{name}, 8 kHz", "sound", Scene(force, Clock(rate=8000.0, samples=16000, fine=8))),
        ]
    found += [Case(f"six components, {name}", "sound", scene, dynamics=as_identified) for name, scene in SIXES.items()]
    return found


def as_identified(known: CoupledDynamics) -> CoupledDynamics:
    """Return the dynamics as they were identified."""
    return known


SIXES: dict[str, SixScene] = {
    "0-347 Hz": SixScene(),
    "0-347 Hz, 2 s": SixScene(clock=replace(SIX, samples=16000)),
    "0-200 Hz": SixScene([band(0.1, 0, 200)] * 6),
    "soft 30 Hz": SixScene([soft(0.1, 30.0)] * 6),
    "narrow at 165 Hz": SixScene([together(band(0.02, 160, 172), band(0.05, 0, 60))] * 6),
    "sine 173 Hz": SixScene([together(shaped(lambda t: 0.05 * np.sin(2 * np.pi * 173.3 * t)), band(0.05, 0, 60))] * 6),
    "rotor of 23 Hz that drifts by 1 %, 2 s": SixScene(
        [level(drifting_rotor(23.0, 0.01), lambda clock, time: np.full(time.size, 1e-3))] * 6,
        clock=replace(SIX, samples=16000),
    ),
    "AF alone": SixScene([*[band(1e-9, 0, 100)] * 5, band(0.1, 0, HIGHEST)]),
    "a release": SixScene([band(1e-9, 0, 100)] * 6, common=step(0.5)),
    "a release in turbulence": SixScene([soft(0.01, 30.0)] * 6, common=step(0.5)),
    "one gust, soft 30 Hz": SixScene([band(1e-9, 0, 100)] * 6, common=soft(0.1, 30.0, 2.0)),
    "one gust, 0-200 Hz": SixScene([band(1e-9, 0, 100)] * 6, common=band(0.03, 0, 200)),
}
"""Loads of six components, over half range."""


def six_components() -> Iterator[Case]:
    """Return records of six components whose channels or dynamics are wrong."""
    loads = {name: SIXES[name] for name in ("0-347 Hz", "soft 30 Hz", "AF alone")}
    for name, scene in loads.items():
        made = partial(Case, group="six", scene=scene)
        for one in COMPONENTS:
            yield made(
                f"six components, sign of {one}, {name}",
                kinds=("swapped sign",),
                change=partial(turned, component=one),
                dynamics=as_identified,
            )
        for one, other in (("NF", "SF"), ("PM", "YM"), ("YM", "RM")):
            yield made(
                f"six components, {one} and {other} exchanged, {name}",
                kinds=("swapped channels",),
                change=partial(exchanged, one=one, other=other),
                dynamics=as_identified,
            )
        for factor in (1.03, 1.1, 0.8):
            yield made(
                f"six components, modes at {factor:g} times their frequency, {name}",
                kinds=("natural frequency",),
                dynamics=partial(moved, factor=factor),
            )
    for milliseconds in (1, 2, 4):
        yield Case(
            f"six components, 3 gaps of {milliseconds} ms in PM, 0-347 Hz",
            "six",
            SIXES["0-347 Hz"],
            change=partial(with_gaps, seconds=1e-3 * milliseconds),
            dynamics=as_identified,
        )


def turned(record: Record, rng: np.random.Generator, *, component: str) -> Record:
    """Return the record with a component, its readings and its force, of the other sign."""
    sign = np.where(np.array(COMPONENTS) == component, -1.0, 1.0)
    return replace(record.with_column(component, -record.columns[component]), force=record.force * sign)


def exchanged(record: Record, rng: np.random.Generator, *, one: str, other: str) -> Record:
    """Return the record with two components exchanged, their readings and their forces."""
    columns = {**record.columns, one: record.columns[other], other: record.columns[one]}
    force, (i, j) = record.force.copy(), (COMPONENTS.index(one), COMPONENTS.index(other))
    force[:, [i, j]] = force[:, [j, i]]
    return replace(record, columns=columns, force=force)


def with_gaps(record: Record, rng: np.random.Generator, *, seconds: float) -> Record:
    """Return the record with three gaps in one of six channels."""
    for _ in range(3):
        record = with_gap(record, rng, seconds=seconds, channel="PM")
    return record


def wrong_dynamics() -> Iterator[Case]:
    """Return dynamics that are not those of the balance."""
    right = ("natural frequency", "damping ratio")
    for name, force in LOADS.items():
        for clock, seconds in ((Clock(), "2.5 s"), (LONG, "10 s")):
            scene = partial(Case, group="dynamics", scene=Scene(force, clock), kinds=right, own=dynamics())
            given = {
                "mass 1 %": changed(mass=1.01),
                "stiffness 0.5 %": changed(stiffness=1.005),
                "stiffness -5 %": changed(stiffness=0.95),
                "stiffness +20 %": changed(stiffness=1.2),
                "damping 20 %": changed(damping=1.2),
                "damping x3": changed(damping=3.0),
                "damping /3": changed(damping=1 / 3),
            }
            for what, model in given.items():
                yield scene(f"{what}, {name}, {seconds}", dynamics=model)
        for f in (20.0, 30.0, 50.0, 80.0, 150.0, 400.0):
            yield Case(
                f"f0 {f:g} Hz, {name}",
                "dynamics",
                Scene(force),
                right,
                dynamics=dynamics(frequency=f, ratio=0.008),
                own=dynamics(),
            )
    short = Clock(samples=960)
    for f in (30.0, 57.0, 100.0):
        yield Case(
            f"f0 {f:g} Hz, step, 0.6 s",
            "dynamics",
            Scene(STEP, short),
            right,
            dynamics=dynamics(frequency=f),
            own=dynamics(),
        )


def on_the_way() -> Iterator[Case]:
    """Return balances whose natural frequency is another after half of 20 s."""
    clock = Clock(samples=32_000)
    loads = {name: LOADS[name] for name in ("broad", "step")}  # a slow one tells no natural frequency
    for name, force in loads.items():
        for share in (0.01, -0.01, 0.03, -0.03):
            yield Case(
                f"f0 {100 * share:+g} % after half, {name}, 20 s",
                "dynamics",
                Scene(force, clock),
                ("natural frequency",),
                change=partial(changed_on_the_way, factor=1 + share),
                own=dynamics(frequency=(1 + share) * FREQUENCY),
                since=0.55,
            )


def changed_on_the_way(record: Record, rng: np.random.Generator, *, factor: float) -> Record:
    """Return what a balance reads whose natural frequency becomes so many times as high about the middle, in 0.3 s."""
    count, force = record.force.size, record.force
    frequency = np.fft.rfftfreq(2 * count, 1 / record.rate)
    before, after = (Modes(((one * FREQUENCY, RATIO, 1.0),)).response(frequency) for one in (1.0, factor))
    lines = np.fft.rfft(np.concatenate([force, force[::-1]]))  # mirrored, so that the ends meet
    change = np.fft.irfft(lines * (after - before), 2 * count)[:count]
    share = np.clip((np.arange(count) - count / 2) / (0.3 * record.rate) + 0.5, 0, 1)
    return replace(record, columns={**record.columns, "AF": record.columns["AF"] + share * change})


def missing_modes() -> Iterator[Case]:
    """Return balances with a further mode that the dynamics lack."""
    kinds = ("missing mode",)
    for factor, share in ((2.3, 0.03), (2.3, -0.03), (1.5, 0.1), (1.05, 0.03), (6.0, 0.02)):
        modes = Modes(((FREQUENCY, RATIO, 1 - share), (factor * FREQUENCY, 0.008, share)))
        for name, force in {"0-200 Hz": band(200.0, 0, 200), "0-100 Hz": BROAD, "step": STEP, "soft": SOFT}.items():
            for clock, seconds in ((Clock(), "2.5 s"), (LONG, "10 s")):
                yield Case(
                    f"mode at {factor:g} f0, {100 * share:g} %, {name}, {seconds}",
                    "missing mode",
                    Scene(force, clock, balance=modes),
                    kinds,
                    own=dynamics(modes=(Mode(factor * FREQUENCY, 0.008, share),)),
                )


def bent_springs() -> Iterator[Case]:
    """Return balances that are not linear."""
    clock = Clock(fine=8)
    span = 2000.0 / STIFFNESS

    def hardening(share: float) -> Callable[[float, float], tuple[float, float]]:
        return lambda x, v: (STIFFNESS * x * (1 + share * (x / span) ** 2), DAMPING * v)

    def friction(size: float) -> Callable[[float, float], tuple[float, float]]:
        return lambda x, v: (STIFFNESS * x, DAMPING * v + size * float(np.tanh(v / 1e-5)))

    def more_damped(share: float) -> Callable[[float, float], tuple[float, float]]:
        return lambda x, v: (STIFFNESS * x, DAMPING * v * (1 + share * abs(STIFFNESS * x) / 1000.0))

    springs = {
        "hardening 1 % at 2 kN": (hardening(0.01), ("not linear", "natural frequency")),
        "hardening 5 % at 2 kN": (hardening(0.05), ("not linear", "natural frequency")),
        "friction 0.5 N": (friction(0.5), ("damping ratio", "not linear")),
        "friction 5 N": (friction(5.0), ("damping ratio", "not linear")),
        "damping +50 % at 1 kN": (more_damped(0.5), ("damping ratio", "not linear")),
    }
    loads = {"0-60 Hz": MIDDLE, "0-100 Hz": BROAD, "step": STEP}
    for name, (spring, kinds) in springs.items():
        for load, force in loads.items():
            yield Case(f"{name}, {load}", "spring", Scene(force, clock, spring=spring), kinds)


def low_pass(corner: float) -> Callable[[Array], np.ndarray[Any, Any]]:
    """A Butterworth filter of second order."""
    return lambda f: 1 / (1 - (f / corner) ** 2 + 1j * np.sqrt(2) * f / corner)


def ground_channels() -> Iterator[Case]:
    """Return faults of the channels of the ground's motion."""
    shaken = partial(Scene, ground=GROUND)
    loads = {"0-60 Hz": MIDDLE, "step": STEP, "0-20 Hz": SLOW}
    for name, force in loads.items():
        made = {
            "5 ms late": (shaken(force, ground_late=5e-3), ("ground delay", "ground filter")),
            "1 ms late": (shaken(force, ground_late=1e-3), ("ground delay", "ground filter")),
            "0.1 ms late": (shaken(force, ground_late=1e-4), ("ground delay", "ground filter")),
            "0.5 ms early": (shaken(force, ground_late=-5e-4), ("ground delay", "ground filter")),
            "clock 100 ppm": (
                shaken(force, ground_late=lambda t: 1e-4 + 1e-4 * t),
                ("ground clock", "ground delay"),
            ),
            "clock 1000 ppm": (shaken(force, ground_late=lambda t: 1e-3 * t), ("ground clock", "ground delay")),
            "filter 300 Hz": (shaken(force, ground_filter=low_pass(300.0)), ("ground filter", "ground delay")),
            "gain 10 %": (shaken(force, ground_gain=1.1), ("ground gain",)),
            "gain 2 %": (shaken(force, ground_gain=1.02), ("ground gain",)),
            "sign": (shaken(force, ground_gain=-1.0), ("ground gain",)),
            "in g": (shaken(force, ground_gain=1 / 9.80665), ("ground gain",)),
            "dead": (shaken(force, ground_gain=0.0), ("ground gain", "dead channel", "stuck channel")),
        }
        for what, (scene, kinds) in made.items():
            seen = what not in ("dead",)  # its noise says nothing, and what it should have read is nowhere
            right = shaken(force) if seen else None
            yield Case(f"accelerometer {what}, {name}", "ground", scene, kinds, shown=seen, right=right)
        yield Case(
            f"accelerometer 3 deg across, {name}",
            "ground",
            shaken(force, ground_beside=0.05),
            ("ground noise",),
            shown=False,
        )
        yield Case(
            f"accelerometer with a gap of 60 ms, {name}",
            "ground",
            shaken(force),
            (),  # what it hides is found by the load, and the rest is in the uncertainty
            change=partial(with_gap, seconds=0.06, channel="ground_acceleration"),
        )
        pitching = partial(Scene, force, pitch=band(0.05, 0, 4))
        pitched = partial(Case, group="ground", right=pitching())
        late, gain = ("attitude delay",), ("attitude gain",)
        yield pitched(f"pitch 20 ms late, {name}", scene=pitching(pitch_late=0.02), kinds=late)
        yield pitched(f"pitch 100 ms late, {name}", scene=pitching(pitch_late=0.1), kinds=late)
        yield pitched(f"pitch sign, {name}", scene=pitching(pitch_gain=-1.0), kinds=gain)
        yield pitched(f"pitch gain 5 %, {name}", scene=pitching(pitch_gain=1.05), kinds=gain)


def with_gap(record: Record, rng: np.random.Generator, *, seconds: float, channel: str = "AF") -> Record:
    """Return the record with a gap in a channel."""
    values = record.columns[channel].copy()
    size = round(seconds * record.rate)
    first = int(rng.integers(values.size // 4, 3 * values.size // 4 - size))
    values[first : first + size] = np.nan
    return record.with_column(channel, values)


def quantized(record: Record, rng: np.random.Generator, *, step: float) -> Record:
    """Return the record with readings of a resolution."""
    return record.with_column("AF", step * np.round(record.columns["AF"] / step))


def with_spikes(
    record: Record, rng: np.random.Generator, *, count: int, size: float, together: int = 1, channel: str = "AF"
) -> Record:
    """Return the record with single wild samples of either sign."""
    values = record.columns[channel].copy()
    for place in rng.choice(np.arange(20, values.size - 20, 10), count, replace=False):
        values[place : place + together] += size * rng.choice([-1.0, 1.0])
    return record.with_column(channel, values)


def with_dropouts(record: Record, rng: np.random.Generator, *, count: int, to: float, together: int = 1) -> Record:
    """Return the record with single samples that fall to a value."""
    values = record.columns["AF"].copy()
    for place in rng.choice(np.arange(20, values.size - 20, 10), count, replace=False):
        values[place : place + together] = to
    return record.with_column("AF", values)


def stuck(record: Record, rng: np.random.Generator, *, seconds: float) -> Record:
    """Return the record with a channel that holds its last reading for some time."""
    values = record.columns["AF"].copy()
    size = min(round(seconds * record.rate), values.size - 1)
    first = int(rng.integers(0, values.size - size))
    values[first : first + size] = values[first]
    return record.with_column("AF", values)


def clipped(record: Record, rng: np.random.Generator, *, share: float, sides: str = "both") -> Record:
    """Return the record cut off at the limit that a share of the readings is beyond."""
    values = record.columns["AF"]
    if sides == "both":
        limit = float(np.quantile(np.abs(values), 1 - share))
        return record.with_column("AF", np.clip(values, -limit, limit))
    limit = float(np.quantile(values, 1 - share))
    return record.with_column("AF", np.minimum(values, limit))


def wild_samples() -> Iterator[Case]:
    """Return single wild samples."""
    loads = {"0-100 Hz": BROAD, "0-20 Hz": SLOW, "step": STEP}
    for name, force in loads.items():
        for count, size in ((1, 99999.0), (5, 1000.0), (5, 100.0), (5, 20.0), (40, 300.0)):
            yield Case(
                f"{count} spikes of {size:g} N, {name}",
                "samples",
                Scene(force),
                ("wild samples",),
                change=partial(with_spikes, count=count, size=size),
            )
        yield Case(
            f"5 spikes of 3 samples, {name}",
            "samples",
            Scene(force),
            ("wild samples",),
            change=partial(with_spikes, count=5, size=1000.0, together=3),
        )
        yield Case(
            f"5 dropouts to zero, {name}",
            "samples",
            Scene(together(force, constant(800.0))),
            ("wild samples",),
            change=partial(with_dropouts, count=5, to=0.0),
        )
        yield Case(
            f"5 spikes in the accelerometer, {name}",
            "samples",
            Scene(force, ground=GROUND),
            ("wild samples",),
            change=partial(with_spikes, count=5, size=50.0, channel="ground_acceleration"),
        )


def limited_channels() -> Iterator[Case]:
    """Return channels that stick, rest on a limit or have few steps."""
    loads = {"0-100 Hz": BROAD, "0-20 Hz": SLOW, "step": STEP}
    for name, force in loads.items():
        for seconds in (0.02, 0.2):
            yield Case(
                f"stuck for {seconds:g} s, {name}",
                "limits",
                Scene(force),
                ("stuck channel",),
                change=partial(stuck, seconds=seconds),
            )
        yield Case(
            f"stuck all the time, {name}",
            "limits",
            Scene(force),
            ("stuck channel",),
            change=partial(stuck, seconds=1e9),
        )
        for share in (0.003, 0.02):
            for sides in ("both", "above"):
                yield Case(
                    f"{100 * share:g} % clipped {sides}, {name}",
                    "limits",
                    Scene(force),
                    ("clipping",),
                    change=partial(clipped, share=share, sides=sides),
                )
    for rms, lsb, noise in ((0.6, 1.0, 0.1), (2.0, 1.0, 0.2), (0.6, 1.0, 0.3), (5.0, 10.0, 1.0)):
        yield Case(
            f"{rms:g} N in steps of {lsb:g} N, noise {noise:g} N",
            "limits",
            Scene(band(rms, 0, 40), noise=noise),
            ("resolution",),
            change=partial(quantized, step=lsb),
        )


def faint_forces() -> Iterator[Case]:
    """Return forces that the noise hides."""
    for rms in (0.1, 0.2, 0.4, 0.8):
        yield Case(f"{rms:g} N, 0-40 Hz, in 2 N of noise", "faint", Scene(band(rms, 0, 40)), ("faint force",))
    for size in (0.2, 0.4, 0.8):
        yield Case(
            f"sine of {size:g} N at 20 Hz in 2 N of noise",
            "faint",
            Scene(shaped(lambda t, size=size: size * np.sin(2 * np.pi * 20 * t))),
            ("faint force",),
        )
    yield Case("5 s, 0.2 N in 2 N of noise", "faint", Scene(band(0.2, 0, 40), Clock(samples=8000)), ("faint force",))


def colors_of_noise() -> Iterator[Case]:
    """Return noise that is not white, and hum that drifts; alone, with a record of noise, and with the hum named."""
    loads = {"0-100 Hz": BROAD, "0-20 Hz": SLOW, "step": STEP, "none": constant(100.0)}
    seen, clock = ("colored noise",), Clock()
    noises: dict[str, tuple[float, Maker, Color, tuple[str, ...]]] = {
        "1/f from 20 Hz": (2.0, soft(1.5, 1.0, 1.0), soft_color(1.5, 1.0, 1.0, clock), seen),
        "hump 250-350 Hz": (2.0, band(5.0, 250, 350), band_color(5.0, 250, 350), seen),
        "noise to 500 Hz": (0.2, soft(2.0, 500.0, 8.0), soft_color(2.0, 500.0, 8.0, clock), seen),
    }
    for drift in (0.0, 0.05, 0.3):
        # a swing of the phase spreads the line over twice the drift
        color = band_color(5 / 2**0.5, 50 - drift - 1e-3, 50 + drift + 1e-3)
        made = partial(hum, size=5.0, drift=drift)
        noises[f"hum of 5 N at 50 Hz that drifts by {drift:g} Hz"] = (2.0, made, color, ("hum",))
    for name, force in loads.items():
        for what, (white, made, color, kinds) in noises.items():
            scene = Scene(force, noise=white, more_noise=made)
            case = partial(Case, group="noise", scene=scene, color=color)
            yield case(f"{what}, {name}", kinds=kinds)
            # with the noise known, nothing is left to be said of it
            yield case(f"{what}, {name}, with a record of noise", calm=replace(scene, force=constant(0.0), clock=LONG))
            if kinds == ("hum",):
                yield case(f"{what}, {name}, named", settings={"hum": (50.0,)})
        yield Case(
            f"noise in bursts, {name}",
            "noise",
            Scene(force, more_noise=level(band(15.0, 0, 790), bursts)),
            ("unexplained", "changing noise"),
        )


def band_color(rms: float, low: float, high: float) -> Color:
    """Return the density of noise of a band [Hz]."""

    def mean(frequency: Array, width: float) -> Array:
        width = max(width, 1e-6)
        inside = np.minimum(frequency + width / 2, high) - np.maximum(frequency - width / 2, low)
        return np.asarray(rms**2 / (2 * (high - low)) * np.maximum(inside, 0.0) / width)

    return mean


def soft_color(rms: float, corner: float, order: float, clock: Clock) -> Color:
    """Return the density of samples of noise with the spectrum 1 / (1 + (f / corner)^order) up to the fine clock's."""
    fine = np.arange(1, round(0.5 / clock.interval))  # every hertz
    power = float(np.sum(1 / (1 + (fine / corner) ** order)) + 0.5)

    def mean(frequency: Array, width: float) -> Array:
        aliases = np.arange(-clock.fine // 2, clock.fine // 2 + 1)[:, None] * clock.rate
        density = 1 / (1 + (np.abs(frequency + aliases) / corner) ** order)
        return np.asarray(rms**2 / (2 * power) * density.sum(axis=0))

    return mean


def bursts(clock: Clock, time: Array) -> Array:
    """Return 1 in a fifth of the record, else 0."""
    return np.asarray((np.mod(time, clock.end / 2) < clock.end / 10).astype(float))


def hum(clock: Clock, rng: np.random.Generator, *, size: float, drift: float) -> Array:
    """Return a line at 50 Hz whose frequency swings by so much [Hz] within some seconds."""
    time = clock.time
    phase = 2 * np.pi * 50 * time + drift / 0.3 * np.sin(2 * np.pi * 0.3 * time + rng.random() * 6)
    return np.asarray(size * np.sin(phase + 6 * rng.random()))


def loads_that_change() -> Iterator[Case]:
    """Return forces that are not of one kind all along."""
    half = lambda clock, time: (time > 0.68 * clock.end).astype(float)  # noqa: E731
    yield Case("quiet, then 300 N", "load", Scene(level(band(300.0, 0, 80), half)), ("changing load",))
    yield Case(
        "5 N, then 300 N",
        "load",
        Scene(together(band(5.0, 0, 30), level(band(300.0, 0, 80), half))),
        ("changing load",),
    )
    yield Case("2 to 4 f0 alone, 200 N", "load", Scene(band(200.0, 2 * FREQUENCY, 4 * FREQUENCY)), ())
    yield Case(
        "20 N slow and 200 N at 2 to 3 f0",
        "load",
        Scene(together(band(20.0, 0, 20), band(200.0, 2 * FREQUENCY, 3 * FREQUENCY))),
        (),
    )
    # where nothing else shows a force, a tone that the balance weakens may be of the electronics
    alone = {
        "tone of 20 N at 160 Hz alone": shaped(lambda t: 20 * np.sin(2 * np.pi * 160.3 * t)),
        "tone that wanders from 137 to 139 Hz alone": wandering(137.0, 139.0),
        "narrow at 68 and 160 Hz, 5 N each": together(band(5.0, 67, 69), band(5.0, 159.8, 160.8)),
    }
    for name, force in alone.items():
        yield Case(name, "load", Scene(force), ("interference",))
    yield Case("square wave of 5 Hz, 200 N", "load", Scene(pieces(square)), ())
    yield Case("telegraph, 200 N", "load", Scene(pieces(telegraph)), ())
    yield Case(
        "half sine of 3 ms, 1000 N",
        "load",
        Scene(shaped(lambda t: 1000 * np.sin(np.pi * (t - 1) / 3e-3) * ((t > 1) & (t < 1.003)))),
        ("unexplained", "shock"),
    )
    yield Case(
        "half sine of 20 ms, 1000 N",
        "load",
        Scene(shaped(lambda t: 1000 * np.sin(np.pi * (t - 1) / 2e-2) * ((t > 1) & (t < 1.02)))),
        ("unexplained", "shock"),
    )
    yield Case(
        "blast of 20 ms, 1000 N",
        "load",
        Scene(shaped(lambda t: 1000 * np.exp(-np.maximum(t - 1, 0) / 0.02) * (t > 1))),
        ("unexplained", "shock"),
    )
    yield Case(
        "chirp of 10 to 200 Hz, 100 N",
        "load",
        Scene(shaped(lambda t: 100 * np.sin(2 * np.pi * (10 * t + 38 * np.clip(t, 0, 2.5) ** 2)) * (t > 0))),
        (),
    )
    for name, first, growth in (("1 to 200 Hz", 1.0, 199.0), ("40 to 100 Hz", 40.0, 60.0)):
        yield Case(
            f"chirp of {name}, 200 N",
            "load",
            Scene(
                shaped(
                    lambda t, first=first, growth=growth: (  # type: ignore[misc]
                        200 * np.sin(2 * np.pi * (first * t + growth / 5 * np.clip(t, 0, 2.5) ** 2))
                    )
                )
            ),
            (),
        )
    yield Case(
        "logarithmic chirp of 2 to 200 Hz, 200 N",
        "load",
        Scene(shaped(lambda t: 200 * np.sin(4 * np.pi * 2.5 / np.log(100) * (100 ** (np.clip(t, 0, 2.6) / 2.5) - 1)))),
        (),
    )
    yield Case("sine at f0, 20 N", "load", Scene(shaped(lambda t: 20 * np.sin(2 * np.pi * FREQUENCY * t))), ())
    yield Case("ramp to 1000 N", "load", Scene(shaped(lambda t: 400 * np.clip(t, 0, 2.5))), ())


def square(clock: Clock, rng: np.random.Generator) -> list[tuple[float, float]]:
    """Return the edges of a square wave of 5 Hz."""
    first = 0.1 * rng.random()
    edges = np.arange(first, clock.end, 0.1)
    return [(float(t), 200.0 * (1 if i == 0 else 2) * (-1) ** i) for i, t in enumerate(edges)]


def telegraph(clock: Clock, rng: np.random.Generator) -> list[tuple[float, float]]:
    """Return edges at random distances of 50 to 200 ms."""
    edges, t, sign = [], 0.05, 1
    while t < clock.end - 0.05:
        edges.append((t, 200.0 * sign * (2 if edges else 1)))
        t, sign = t + rng.uniform(0.05, 0.2), -sign
    return edges


def oversampled() -> Iterator[Case]:
    """Return records sampled far above the natural frequency, with noise that is not white there."""
    for times in (20, 50, 100):
        clock = Clock(rate=times * FREQUENCY, samples=int(2.0 * times * FREQUENCY), fine=4)
        nyquist = times * FREQUENCY / 2
        for name, force in {"0-100 Hz": BROAD, "step": STEP, "0-20 Hz": SLOW}.items():
            yield Case(f"{times} f0, white, {name}", "oversampled", Scene(force, clock), ())
            yield Case(
                f"{times} f0, noise rolled off, {name}",
                "oversampled",
                Scene(force, clock, noise=0.05, more_noise=soft(2.0, 0.4 * nyquist, 8.0)),
                ("colored noise",),
            )
            yield Case(
                f"{times} f0, noise rising, {name}",
                "oversampled",
                Scene(force, clock, noise=1.0, more_noise=band(4.0, 0.5 * nyquist, 0.98 * nyquist, fall=-4.0)),
                ("colored noise",),
            )


def filters_not_told() -> Iterator[Case]:
    """Return analog filters that nothing is said of."""
    for name, force in {"0-100 Hz": BROAD, "step": STEP}.items():
        for corner in (640.0, 300.0):
            yield Case(
                f"load behind a filter of {corner:g} Hz, {name}",
                "filter",
                Scene(force, load_filter=low_pass(corner)),
                ("load filter",),
                shown=False,
            )
            yield Case(
                f"both behind a filter of {corner:g} Hz, {name}",
                "filter",
                Scene(force, load_filter=low_pass(corner), ground=GROUND, ground_filter=low_pass(corner)),
                ("load filter",),
                shown=False,
            )


def clocks() -> Iterator[Case]:
    """Return sampling rates that are wrong."""
    for name, force in LOADS.items():
        for factor in (0.2, 0.5, 0.99, 1.02, 2.0, 1000.0):

            def other(record: Record, rng: np.random.Generator, factor: float = factor) -> Record:
                return replace(record, rate=record.rate * factor)

            yield Case(
                f"rate {factor:g} times the true one, {name}",
                "clock",
                Scene(force),
                ("natural frequency", "record too short", "clock"),
                change=other,
                own=dynamics(frequency=factor * FREQUENCY),
            )


def direct_inverses() -> Iterator[Case]:
    """Return the inverses that are not optimal."""
    for name, force in {"0-60 Hz": MIDDLE, "step": STEP}.items():
        yield Case(f"bandwidth 100 Hz, {name}", "direct", Scene(force), ("bandwidth",), settings={"bandwidth": 100.0})
        yield Case(f"bandwidth 300 Hz, {name}", "direct", Scene(force), ("bandwidth",), settings={"bandwidth": 300.0})
        yield Case(f"three points, {name}", "direct", Scene(force), ("three points",), settings={"method": "paper"})
        yield Case(
            f"bandwidth 100 Hz, stiffness +5 %, {name}",
            "direct",
            Scene(force),
            ("natural frequency",),
            dynamics=changed(stiffness=1.05),
            settings={"bandwidth": 100.0},
            own=dynamics(),
        )
