"""Whether a record speaks for the dynamics that it is read with, or for others: their evidence, compared.

Read with the dynamics of another balance, a record needs a force that undoes the one resonance and makes the other:
narrow bands of force where the balance rings, and a hole in its spectrum where the dynamics have their resonance. Such
a force costs more numbers than the one that is there. So the spectrum of the force is learned once with each of some
dynamics from the same readings, steps left in, and Schwarz's criterion, by which the spectrum itself was chosen,
chooses among them as well. That needs no record of a given length and no load of a given kind.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from aerobalance.dynamics.modal import Mode
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.checks.evidence import Evidence, evidence_in, numbers_of
from aerobalance.estimation.checks.free_oscillation import (
    BesideSteps,
    evidence_beside,
    gain_after_a_blow,
    gain_beside,
)
from aerobalance.estimation.checks.near_resonance import near_resonance
from aerobalance.estimation.checks.spoken import (
    MOVED,
    OF_LOAD,
    SETTINGS,
    Spoken,
    gain_over_narrow_loads,
    is_line,
    named,
    open_far,
    price_of,
)
from aerobalance.estimation.observation import SpectralPrior
from aerobalance.estimation.steps import Step
from aerobalance.recording.channel import Array


def spoken_for(
    values: Array,
    dynamics: Dynamics,
    *,
    interval: float,
    least_noise: float,
    learned: SpectralPrior | None = None,
    color_found: bool = True,
    steps: Sequence[Step] = (),
    beside_steps: BesideSteps | None = None,
) -> Spoken | None:
    """Return the dynamics that a record speaks for instead of its own, and how clearly; None where it does not.

    Where a load in narrow bands explains far better what others gain, they come with no probability.

    Parameters
    ----------
    values
        Readings without gaps, hum and other tones, shape (n,) [N].
    dynamics
        The dynamics that they are read with.
    interval
        Time between samples [s].
    least_noise
        Least noise of a reading [N].
    learned
        What was learned of force and noise; None if nothing was.
    color_found
        Whether the color of the noise was found in the record, and not in one of noise alone.
    steps, beside_steps
        Steps that were found in them, and what the readings are without some of these and without the free oscillation
        from their begin with some dynamics, shape (n,) [N]. The ringing after steps tells more of a resonance near the
        expected one (`change_by_steps`). And a load of many steps has a spectrum of many lines, each of which may look
        like a resonance.
    """
    evidence = evidence_in(values, interval=interval, least_noise=least_noise, learned=learned)
    none = dynamics.retuned(frequency=SETTINGS.beyond, damping=1.0)
    near = None if steps else near_resonance(evidence.values, interval, dynamics)
    peaks = evidence.peaks(dynamics)
    others = [other for _, other in _others(dynamics, peaks, confirmed=-np.inf)]
    evidence = replace(evidence, among=(dynamics, none, *others, *(() if near is None else (near,))))
    own = evidence.of(dynamics)
    confirmed = own - evidence.of(none)
    tried = [("no resonance", none), *_others(dynamics, peaks, confirmed=confirmed)]
    likely = [other for _, other in tried if evidence.may_gain(other, dynamics, SETTINGS.worth_a_look)]
    best = max(evidence.of(other) for other in (none, *likely)) - own
    clear = load = None
    if best >= SETTINGS.decisive:
        left, load = _beside_narrow_loads(evidence, dynamics, tried, own=own)
        best = max((evidence.of(other) for _, other in left), default=own) - own
        if best >= SETTINGS.decisive:
            clear, load = _clearest(evidence, dynamics, left, own=own, best=best), None
    elif -confirmed >= SETTINGS.open_far and not steps:
        clear = open_far(Spoken("no resonance", none, -confirmed))
    if evidence.color is not None and color_found and (clear is None or clear.probability < 1):
        plain = _without_color(evidence, dynamics, tried)
        if plain is not None:
            evidence, clear = plain
    if clear is not None:
        clear = named(clear, evidence, dynamics, confirmed=confirmed)
    if clear is not None and steps and beside_steps is not None:
        # other dynamics may need the largest step alone, where the expected ones need many that mend them
        largest = [max(steps, key=lambda step: abs(step.height))]
        with_steps = [
            evidence_beside(evidence, beside_steps(one, some), one, some)
            for one, some in ((dynamics, steps), (clear.dynamics, steps), (clear.dynamics, largest))
        ]
        line = _apart(steps, dynamics) >= SETTINGS.many and clear.kind in MOVED
        if with_steps[0] > max(*with_steps[1:], evidence.of(clear.dynamics)) + SETTINGS.by_steps or (
            line and is_line(clear.dynamics.modes[0], evidence, width=SETTINGS.line_beside)
        ):
            clear = None
    elif clear is not None and beside_steps is not None and not _stands(clear, evidence, dynamics, beside_steps):
        clear = None
    if near is not None and (clear is None or clear.probability < 1):
        clear = _beside(evidence, dynamics, near, own=own, confirmed=confirmed, beside_steps=beside_steps) or clear
    return clear or load


def gain_in_white_noise(values: Array, dynamics: Dynamics, *, interval: float, least_noise: float) -> float:
    """Return the gain in log-likelihood of other dynamics over a record's own, the noise being white; 0 for none.

    The price of their numbers is paid. Others are those with a further mode, another natural frequency or damping
    ratio. They must be likelier than no resonance at all, which lets through whatever noise there is.

    Parameters
    ----------
    values, dynamics, interval, least_noise
        As for `spoken_for`.
    """
    evidence = evidence_in(values, interval=interval, least_noise=least_noise, learned=None)
    # what a resonance that they lack makes of a force is stronger than that is elsewhere; most noise is not
    if replace(evidence, rising=True, _known={}).of(dynamics) < evidence.of(dynamics) + SETTINGS.decisive:
        return 0.0
    none = dynamics.retuned(frequency=SETTINGS.beyond, damping=1.0)
    peaks = evidence.peaks(dynamics)
    others = [other for _, other in _others(dynamics, peaks, confirmed=-np.inf)]
    evidence = replace(evidence, among=(dynamics, none, *others), _known={}, _edges=None)
    own, silent = evidence.of(dynamics), evidence.of(none)
    tried = list(_others(dynamics, peaks, confirmed=own - silent))
    best = max((evidence.of(other) for _, other in tried), default=own)
    if best < max(own, silent) + SETTINGS.decisive:
        return 0.0
    spoken = _clearest(evidence, dynamics, tried, own=own, best=best - own)
    clear = spoken is not None and own + spoken.gain >= silent + SETTINGS.decisive
    return spoken.gain if spoken is not None and clear else 0.0


def _clearest(
    evidence: Evidence, dynamics: Dynamics, tried: Sequence[tuple[str, Dynamics]], *, own: float, best: float
) -> Spoken | None:
    """The dynamics that gain most of those near some that were tried; None where that is not decisive.

    A further mode that is not decisive comes with its probability, where the record leaves it open.
    """
    # whether one resonance has moved or there is one more shows only when each has come to its best
    found = []
    for start in _starts(evidence, tried, own=own, best=best):
        if start.kind == "no resonance":
            found.append(start)
            continue
        other = _best_from(evidence, start, dynamics, tried)
        found.append(start._replace(dynamics=other, gain=evidence.of(other) - own - price_of(start.kind, evidence)))
    spoken = max(found, key=lambda one: one.gain)
    if spoken.kind != "no resonance":
        # a search that has come to rest may go on where it is begun again the other way round
        for scale in (-1.0, SETTINGS.closer):
            other = _best_near(evidence, spoken.kind, dynamics, spoken.dynamics, scale=scale)
            gain = evidence.of(other) - own - price_of(spoken.kind, evidence)
            spoken = max(spoken, Spoken(spoken.kind, other, gain), key=lambda one: one.gain)
    if spoken.gain >= SETTINGS.decisive:
        return spoken
    far = (
        spoken.kind == "missing mode"
        or abs(spoken.mode.natural_frequency / dynamics.natural_frequency - 1) >= SETTINGS.far
    )
    return open_far(spoken) if far and spoken.gain >= SETTINGS.open_far else None


def _best_from(
    evidence: Evidence, start: Spoken, dynamics: Dynamics, tried: Sequence[tuple[str, Dynamics]]
) -> Dynamics:
    """The most evident dynamics near some that were tried, a further mode of any share among them.

    Of one sign a further mode has a likeliest share, and of the other sign another, its frequency a percent off. At
    first either may be likelier, and no search leads from one to the other.
    """
    if start.kind != "missing mode":
        return _best_near(evidence, start.kind, dynamics, start.dynamics)

    def share(other: Dynamics) -> float:
        return other.further_modes[-1].share

    at = start.dynamics.further_modes[-1].natural_frequency
    modes = [one for kind, one in tried if kind == start.kind and one.further_modes[-1].natural_frequency == at]
    modes.sort(key=evidence.of, reverse=True)
    firsts = {share(one) > 0: one for one in reversed(modes)}
    best = max((_best_near(evidence, start.kind, dynamics, one) for one in firsts.values()), key=evidence.of)
    alike = [one for one in modes if share(one) * share(best) > 0 and one not in firsts.values()]
    return max([best, *(_best_near(evidence, start.kind, dynamics, one) for one in alike)], key=evidence.of)


def _starts(evidence: Evidence, tried: Sequence[tuple[str, Dynamics]], *, own: float, best: float) -> list[Spoken]:
    """The likeliest of each kind of dynamics that were tried, where they come near the best gain."""
    found = []
    for kind in dict.fromkeys(kind for kind, _ in tried):
        start = max((other for name, other in tried if name == kind), key=evidence.of)
        gain = evidence.of(start) - own
        if gain >= min(SETTINGS.decisive, best - SETTINGS.decisive):
            found.append(Spoken(kind, start, gain - price_of(kind, evidence)))
    return found


def _beside_narrow_loads(
    evidence: Evidence, dynamics: Dynamics, tried: Sequence[tuple[str, Dynamics]], *, own: float
) -> tuple[list[tuple[str, Dynamics]], Spoken | None]:
    """Other dynamics that were tried without those of which a load in narrow bands explains far better what they gain.

    The likeliest of these comes with them, with no probability; None where there are none. To bring them to their
    best takes ten times as long, and changes nothing of that.
    """
    left, load, least = list(tried), None, SETTINGS.band_at_first
    while left:
        best = max(evidence.of(other) for _, other in left) - own
        starts = sorted(_starts(evidence, left, own=own, best=best), key=lambda one: -one.gain)
        if best < SETTINGS.decisive or starts[0].kind == "no resonance":
            break
        loads = [
            one
            for one in starts
            if one.kind != "no resonance" and gain_over_narrow_loads(one, evidence, dynamics, enough=least) < least
        ]
        if not loads:
            break
        load = load or loads[0]._replace(probability=0.0)
        # no resonance at all gains by the same load, and less
        left = [
            (kind, other)
            for kind, other in left
            if kind != "no resonance" and not any(_at(one, kind, other) for one in loads)
        ]
    return left, load


def _at(spoken: Spoken, kind: str, other: Dynamics) -> bool:
    """Whether other dynamics are of the kind and tell of the frequency of some."""
    away = Spoken(kind, other, 0.0).mode.natural_frequency / spoken.mode.natural_frequency - 1
    return kind == spoken.kind and abs(away) < OF_LOAD


def _without_color(
    evidence: Evidence, dynamics: Dynamics, tried: Sequence[tuple[str, Dynamics]]
) -> tuple[Evidence, Spoken] | None:
    """Evidence without the color of the noise, and the further mode that it speaks clearly for; None where for none.

    The color was found with the expected dynamics. Where a force explains the readings better than such a noise, what
    it has of a resonance that they lack is no noise. A balance that rings elsewhere or not at all is no question here:
    it passes what is noise indeed.
    """
    plain = replace(evidence, white=None, color=None, rising=True, _known={})
    modes = [one for one in tried if one[0] == "missing mode"]
    own = plain.of(dynamics)
    if not modes or own <= evidence.of(dynamics):
        return None
    best = max(plain.of(other) for _, other in modes) - own
    found = None if best < SETTINGS.decisive else _clearest(plain, dynamics, modes, own=own, best=best)
    return None if found is None or found.probability < 1 else (plain, found)


def _beside(
    evidence: Evidence,
    dynamics: Dynamics,
    near: Dynamics,
    *,
    own: float,
    confirmed: float,
    beside_steps: BesideSteps | None,
) -> Spoken | None:
    """The dynamics with a resonance beside the expected one, and how probable they are; None where they are not.

    Nothing is paid for their two numbers: a resonance is looked for where one is known to be.
    """
    if not evidence.may_gain(near, dynamics, 0.0) or evidence.of(near) - own < SETTINGS.worth_a_look:
        return None
    start, least = Spoken("natural frequency", near, 0.0), SETTINGS.band_at_first
    if gain_over_narrow_loads(start, evidence, dynamics, enough=least) < least:
        return None
    other = _best_near(evidence, "natural frequency", dynamics, near)
    gain = evidence.of(other) - own
    if gain >= SETTINGS.open_from and beside_steps is not None:
        gain = min(gain, gain_beside(evidence, dynamics, other, beside_steps))
    if gain < SETTINGS.open_from:
        return None
    spoken = named(Spoken("natural frequency", other, gain), evidence, dynamics, confirmed=confirmed)
    if spoken is None or gain >= SETTINGS.decisive_near:
        return spoken
    off = float(np.log(other.damping_ratio / dynamics.damping_ratio) / np.log(SETTINGS.usual))
    likely = left_open(spoken, gain - 0.5 * off**2)
    return None if likely is None else likely._replace(probability=likely.probability * spoken.probability)


def left_open(spoken: Spoken, gain: float) -> Spoken | None:
    """The same with its probability by a gain in log-likelihood that is not decisive; None where chance gives that."""
    if gain < SETTINGS.open_from:
        return None
    return spoken._replace(probability=float(expit(SETTINGS.open_steepness * (gain - SETTINGS.open_half))))


def _apart(steps: Sequence[Step], dynamics: Dynamics) -> int:
    """Number of steps of which those less than a period of the balance apart count as one: they mend each other."""
    ends = -np.inf
    count = 0
    for step in sorted(steps, key=lambda one: one.instant):
        count += step.instant > ends + 1 / dynamics.natural_frequency
        ends = max(ends, step.instant + step.duration)
    return count


def _stands(clear: Spoken, evidence: Evidence, dynamics: Dynamics, beside_steps: BesideSteps) -> bool:
    """Whether other dynamics are believed beside a free oscillation, from the begin or after the largest reading."""
    if clear.kind == "no resonance":
        return gain_after_a_blow(evidence, dynamics, clear.dynamics, beside_steps) < SETTINGS.decisive
    if clear.kind not in MOVED or clear.probability < 1:
        return True
    gain = gain_beside(evidence, dynamics, clear.dynamics, beside_steps) - price_of(clear.kind, evidence)
    return gain >= SETTINGS.decisive


def _others(dynamics: Dynamics, peaks: list[float], *, confirmed: float) -> Iterator[tuple[str, Dynamics]]:
    """Dynamics that are tried, and what each says."""
    if confirmed < SETTINGS.confirmed:
        for shift in SETTINGS.shifts:
            yield "natural frequency", dynamics.retuned(frequency=1 + shift, damping=1.0)
        if dynamics.damping_ratio > 0:
            for factor in SETTINGS.dampings:
                yield "damping ratio", dynamics.retuned(frequency=1.0, damping=factor)
    # the slope of a known resonance may be the highest peak
    apart = [
        peak for peak in peaks if all(abs(peak / mode.natural_frequency - 1) > SETTINGS.far for mode in dynamics.modes)
    ]
    for peak in peaks:
        near = abs(peak / dynamics.natural_frequency - 1) < SETTINGS.far  # a little off, it explains much as well
        if near or peak == peaks[0] or confirmed < SETTINGS.confirmed:
            yield "natural frequency", dynamics.retuned(frequency=peak / dynamics.natural_frequency, damping=1.0)
        large = peak in (*peaks[:1], *apart[:1])
        for share, ratio in (*SETTINGS.shares, *(SETTINGS.large_shares if large else ())):
            yield "missing mode", dynamics.with_modes(*dynamics.further_modes, Mode(peak, ratio, share))


def _best_near(evidence: Evidence, kind: str, dynamics: Dynamics, start: Dynamics, *, scale: float = 1.0) -> Dynamics:
    """The most evident dynamics near some: their resonance moved, or the further mode.

    `scale` is the size of the first steps over the usual one; below zero they go the other way.
    """
    if kind == "missing mode":
        mode = start.further_modes[-1]

        def made(point: Array) -> Dynamics:
            f, ratio, share = np.exp(point) * numbers_of(mode)
            return dynamics.with_modes(*dynamics.further_modes, Mode(f, ratio, share))

        size = np.array([0.01, 0.5, 0.5])
    else:
        if dynamics.damping_ratio == 0:
            return start

        def made(point: Array) -> Dynamics:
            w, ratio = np.exp(point)
            return start.retuned(frequency=float(w), damping=float(ratio))

        size = np.array([0.01, 0.5])

    def loss(point: Array) -> float:
        try:
            return -evidence.nearly(made(point * scale * size), start)
        except ValueError:  # outside what dynamics can be
            return 1e12

    found = minimize(
        loss,
        np.zeros(size.size),
        method="Nelder-Mead",
        options={
            "maxfev": round(SETTINGS.most_tries / abs(scale)),
            "xatol": 0.02,
            "fatol": 0.1,
            "initial_simplex": _simplex(size.size),
        },
    )
    return made(found.x * scale * size)


def _simplex(count: int) -> Array:
    return np.vstack([np.zeros(count), np.eye(count)])
