"""From recordings to the fit of all releases: free decays first, then the edge of each release."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aerobalance.identification.coupled.era import Guess, first_guess, fit_state
from aerobalance.identification.coupled.free_response import FreeMotion
from aerobalance.identification.coupled.internal_coordinates import renewed
from aerobalance.identification.coupled.least_squares import motion_of, noise_of_residuals, whitener_of
from aerobalance.identification.coupled.units import Units, with_hidden
from aerobalance.identification.step_relaxation.fit import (
    ReleaseFit,
    others_than,
    replaced,
    settle,
    total_squares,
)
from aerobalance.identification.step_relaxation.model import Kind, Linear, Segment, state_at_the_edge
from aerobalance.identification.step_relaxation.record import ROUNDING, ReleaseRecord
from aerobalance.recording.channel import Array
from aerobalance.recording.errors import FitError


@dataclass(frozen=True, slots=True)
class StageSettings:
    """Thresholds of the way from recordings to the fit of all releases.

    Attributes
    ----------
    guards
        Times after the onset from which the loads are tried as decaying freely [s].
    least_held
        Readings before the onset that tie a release to the loads held.
    evidence
        Drop in the sum of squares over the noise variance that a richer shape of the edge must bring.
    at_first
        Time after the beginning of a free decay that is looked at for what is no free decay [s].
    trial_steps
        Gauss-Newton steps after which a shape of the edge is taken not to explain a record.
    louder
        Variance of the noise before a release over that after it which is still taken for the same.
    apart
        Part of a load let go, each of size 1, that the others leave, above which it tells something of its own.
    durations
        Durations of a release that are tried, over the time between the onset and the free decay.
    """

    guards: tuple[float, ...] = (0.0, 0.002, 0.005, 0.01, 0.02)
    least_held: int = 8
    evidence: float = 20.0
    at_first: float = 0.001
    trial_steps: int = 25
    louder: float = 1.2
    apart: float = 1e-3
    durations: tuple[float, ...] = (0.03, 0.1, 0.2, 0.4, 0.7, 1.0, 1.5)


SETTINGS: Final = StageSettings()
"""Thresholds that are used."""


POOR: Final = 3.0
"""Squares over the noise variance and a reading, above which a first guess is tried further from the edge."""


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Where a fit begins: a guess of the matrices [SI], and the time after the onsets from which it holds [s]."""

    guess: Guess
    guard: float


def fit_releases(records: Sequence[ReleaseRecord], *, sizes: Array, internal: int = 0) -> tuple[ReleaseFit, Units]:
    """Fit the matrices to all records, with e internal coordinates.

    Raises
    ------
    FitError
        No first guess explains the decays, or the fit does not settle.
    """
    free, units = fit_decays(records, sizes=sizes, start=guess_of(records, internal=internal))
    return with_edges(free, records, units), units


def fit_decays(records: Sequence[ReleaseRecord], *, sizes: Array, start: Start) -> tuple[ReleaseFit, Units]:
    """Fit the matrices to the free decays of all records.

    Raises
    ------
    FitError
        The fit does not settle.
    """
    noise = np.array([np.min([record.noise[i] for record in records]) for i in range(sizes.size)]) / sizes
    spring, brake = start.guess.spring, start.guess.brake
    poles = FreeMotion.of(spring, brake).poles
    units = Units(sizes, float(np.exp(np.mean(np.log(np.abs(poles))))))
    least = np.full(sizes.size, ROUNDING)
    free = _settled_free(
        records,
        units,
        units.matrices(spring, brake),
        guard=start.guard,
        noise=np.diag(np.maximum(noise, least) ** 2),
    )
    return _with_noise(free, least), units


def with_edges(free: ReleaseFit, records: Sequence[ReleaseRecord], units: Units) -> ReleaseFit:
    """Take up the loads held before the decays, where they begin as a release does.

    Raises
    ------
    FitError
        There are internal coordinates, and no release tells what the load makes of them, or the fit does not settle.
    """
    edged = free
    for number, record in enumerate(records):
        found = _with_edge(free, number, record, units)
        edged = replaced(edged, number, segment=found.segments[number], own=found.own[number])
    if free.internal:
        _check_let_go(edged)  # then what fits from anywhere, and from rest
        near = float(edged.parameters)  # a start from which the next fit settles: a deviation off in each
        edged = _from_rest(settle(edged.segments, edged.matrices, edged.own, noise=edged.noise, flat=near))
    try:
        settled = settle(edged.segments, edged.matrices, edged.own, noise=edged.noise)
        return _with_noise(settled, np.full(free.size, ROUNDING))
    except FitError:  # edges that do not agree with each other: the free decays stand
        if free.internal:
            raise
        return free


def _with_noise(fit: ReleaseFit, least: Array) -> ReleaseFit:
    return settle(
        fit.segments,
        fit.matrices,
        fit.own,
        noise=noise_of_residuals(fit.residuals, degrees_of_freedom=fit.degrees_of_freedom, least=least),
    )


def _check_let_go(fit: ReleaseFit) -> None:
    """Refuse internal coordinates where the loads that are let go are fewer than the components."""
    n = fit.size
    loads = [
        own[n : 2 * n] - own[:n] for segment, own in zip(fit.segments, fit.own, strict=True) if segment.kind != "free"
    ]
    table = np.array([load / np.linalg.norm(load) for load in loads]).reshape(-1, n)
    apart = int(np.count_nonzero(np.linalg.svd(table, compute_uv=False) > SETTINGS.apart))
    if apart < n:
        raise FitError(
            f"a mode of the model or sting needs releases of a held load along every component, {n} that are no "
            f"combinations of each other; there are {apart} among "
            f"{', '.join(segment.name for segment in fit.segments)}"
        )


def _from_rest(fit: ReleaseFit) -> ReleaseFit:
    """The fit with internal coordinates that are at rest at zero before every release, not settled."""
    starts = [
        np.concatenate(state_at_the_edge(segment, own))
        for segment, own in zip(fit.segments, fit.own, strict=True)
        if segment.kind != "free"
    ]
    matrices, turn = renewed(fit.matrices, fit.size, let_go=np.array(starts).T)
    n, unseen = fit.size, 2 * fit.internal
    own = [
        np.concatenate([mine[:n], turn @ mine[n:]]) if segment.kind == "free" else mine[:-unseen]
        for segment, mine in zip(fit.segments, fit.own, strict=True)
    ]
    segments = tuple(replace(segment, anywhere=False) for segment in fit.segments)
    return replace(fit, segments=segments, matrices=matrices, own=tuple(own))


def guess_of(
    records: Sequence[ReleaseRecord], *, internal: int = 0, guards: Sequence[float] = SETTINGS.guards
) -> Start:
    """First guess of the matrices, from the onsets on or from as soon after them as the decays are explained.

    Raises
    ------
    FitError
        No motion of so many modes explains the decays.
    """
    best: Start | None = None
    rate = records[0].rate
    noise = np.min([record.noise for record in records], axis=0)
    for guard in guards:
        decays = decays_of(records, guard)
        found = first_guess(decays, rate=rate, internal=internal) if decays else None
        if found is None:
            continue
        count = sum(decay.size for decay in decays)
        scale = with_hidden(noise, len(found.spring))
        ratio = np.outer(scale, 1 / scale)
        found = Guess(found.spring * ratio, found.brake * ratio, found.squares / count)
        if best is None or found.squares < 0.5 * best.guess.squares:
            best = Start(found, guard)
        if best.guess.squares < POOR:
            break
    if best is None:
        raise FitError(
            f"{', '.join(record.name for record in records)}: no {noise.size + internal} modes explain the decays; "
            "record them for longer, at a higher rate, or add releases along other components"
        )
    return best


def decays_of(records: Sequence[ReleaseRecord], guard: float) -> list[Array]:
    """Loads over their noise from a time after the onsets on [s], of the records that are long enough."""
    noise = np.min([record.noise for record in records], axis=0)
    firsts = [record.onset + 4 + round(guard * record.rate) for record in records]
    return [
        record.values[first:] / noise
        for record, first in zip(records, firsts, strict=True)
        if record.values.shape[0] - first > 8 * noise.size
    ]


def _settled_free(
    records: Sequence[ReleaseRecord], units: Units, matrices: Array, *, guard: float, noise: Array
) -> ReleaseFit:
    """All records as free decays; those whose first readings do not decay freely, from a later time on."""
    guards = [guard] * len(records)
    while True:
        fit = _free(records, units, matrices, guards=guards, noise=noise)
        later = [
            next(
                (longer for longer in SETTINGS.guards if longer > used and _disturbed(linear.ringing, fit, record)),
                used,
            )
            for linear, record, used in zip(fit.linears, records, guards, strict=True)
        ]
        if later == guards:
            return fit
        matrices, guards = fit.matrices, later


def _disturbed(left: Array, fit: ReleaseFit, record: ReleaseRecord) -> bool:
    """Whether the first residuals of a free decay are far worse than the others."""
    length = max(round(SETTINGS.at_first * record.rate), 16)
    count = left.shape[0] // length
    if count < 8:
        return False
    squares = np.sum((left[: count * length] @ whitener_of(fit.noise).T) ** 2, axis=1)
    blocks = squares.reshape(count, length).mean(axis=1)
    return bool(blocks[0] > (1 + 8 * np.sqrt(2 / (length * fit.size))) * float(np.median(blocks)))


def _free(
    records: Sequence[ReleaseRecord], units: Units, matrices: Array, *, guards: Sequence[float], noise: Array
) -> ReleaseFit:
    segments, own = [], []
    motion = motion_of(matrices, units.sizes.size)
    for record, guard in zip(records, guards, strict=True):
        time = (record.time - record.time[record.onset]) * units.rate
        begin = float((4 / record.rate + guard) * units.rate) if record.onset else float(time[0])
        internal = motion.size - motion.components
        segment = Segment(record.name, time, record.values / units.sizes, "free", (begin, begin), internal)
        first = int(np.searchsorted(time, begin))
        segments.append(segment)
        own.append(fit_state(motion, time[first:] - begin, segment.values[first:])[0])
    return settle(segments, matrices, own, noise=noise)


def _with_edge(fit: ReleaseFit, number: int, record: ReleaseRecord, units: Units) -> ReleaseFit:
    """The fit with one record taken as a release from rest, at once or over a duration, where that explains it."""
    segment = fit.segments[number]
    before = int(np.searchsorted(segment.time, -margin_of(record, units)))
    if before < SETTINGS.least_held:
        return fit
    held, earliest = segment.values[:before].mean(axis=0), float(segment.time[before - 1])
    known = others_than(fit, number)
    loose = total_squares([fit.linears[number]], known, fit.matrices)
    kinds: tuple[tuple[Kind, tuple[float, ...]], ...] = (("release", (0.0,)), ("ramp", SETTINGS.durations))
    for kind, parts in kinds:
        begun = [
            _best_instant(fit, number, held=held, duration=part * (segment.edge[1] - earliest) / 2, earliest=earliest)
            for part in parts
        ]
        place = int(np.argmin([squares for _, _, squares in begun]))
        instant, rest, _ = begun[place]
        own = np.concatenate([rest[: fit.size], held, [instant]])
        edge = (instant, instant)
        if kind == "ramp":
            own = np.append(own, parts[place] * (segment.edge[1] - earliest) / 2)
            edge = (earliest, segment.edge[1] + SETTINGS.at_first * units.rate)
        own = np.append(own, rest[fit.size :])
        trial = replace(segment, kind=kind, edge=edge, anywhere=fit.internal > 0)
        try:
            tight = settle(
                [trial], fit.matrices, [own], noise=fit.noise, known=known, steps=SETTINGS.trial_steps, enough=1.0
            )
        except FitError:
            continue
        allowed = SETTINGS.evidence + 6 * fit.size + _fresh(tight.linears[0], fit.linears[number].rows, fit.noise)
        if total_squares(tight.linears, known, tight.matrices) - loose < allowed:
            return replaced(fit, number, segment=trial, own=tight.own[0])
    return fit


def _fresh(linear: Linear, rows: int, noise: Array) -> float:
    """Squares that noise may leave in the readings that the free decay does not use."""
    count = (linear.rows - rows) * noise.shape[0]
    return float(count + 5 * np.sqrt(2 * count)) * SETTINGS.louder


def margin_of(record: ReleaseRecord, units: Units) -> float:
    """Time before the onset from which readings are not taken as held."""
    return float(max(4 / record.rate * units.rate, 2.0))


def _best_instant(
    fit: ReleaseFit, number: int, *, held: Array, duration: float, earliest: float
) -> tuple[float, Array, float]:
    """Instant at which a release from rest leads best to the free decay found, what belongs to it, and the squares.

    What belongs to it are the loads that stay, and the internal coordinates and their rates at the instant; the
    squares are those of the residuals that this leaves.
    """
    segment, motion, n = fit.segments[number], fit.motion, fit.size
    size = motion.size
    begin = segment.edge[1]
    factor = fit.linears[number].block[: segment.own, : segment.own]
    interval = float(np.median(np.diff(segment.time)))
    step = min(0.05 / float(np.abs(motion.poles).max()) * 2 * np.pi, interval)
    grid = np.arange(earliest, begin - duration, step)
    place, weight = (np.polynomial.legendre.leggauss(16)[0] + 1) / 2, np.polynomial.legendre.leggauss(16)[1] / 2
    growth = np.exp(motion.poles * (begin - grid)[:, None])
    growth = growth * (np.exp(-motion.poles[:, None] * duration * place) @ weight)
    state = np.vstack([motion.shapes, motion.shapes * motion.poles])
    begins = [*range(size), *range(size + n, 2 * size)]  # the loads have no rates
    moved = np.real(np.einsum("ik,gk,kj->gij", state, growth, motion.participation[:, begins]))
    moved, unseen = moved[:, :, :n], moved[:, :, n:]
    design = np.concatenate([np.broadcast_to(np.eye(n), (grid.size, n, n)), -moved], axis=1)  # by the loads that stay
    if fit.internal:
        nothing = np.zeros((grid.size, n, unseen.shape[2]))
        design = np.concatenate([design, np.concatenate([nothing, unseen], axis=1)], axis=2)
    aim = fit.own[number] - np.concatenate([np.zeros((grid.size, n)), moved @ held], axis=1)
    table, target = factor @ design, aim @ factor.T
    normal = np.swapaxes(table, 1, 2) @ table
    rest = np.linalg.solve(normal, np.einsum("gij,gi->gj", table, target)[:, :, None])[:, :, 0]
    squares = np.sum((target - np.einsum("gij,gj->gi", table, rest)) ** 2, axis=1)
    best = int(np.argmin(squares))
    return float(grid[best]), rest[best], float(squares[best])
