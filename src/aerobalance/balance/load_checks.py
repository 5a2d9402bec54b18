"""What loads from gauge outputs are warned of: units, range, iteration, averaged points, zeros, dead bridges."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import COMPONENTS, si_unit
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import FitError, OfLoads, warn_quality
from aerobalance.recording.linalg import table_covariance, whole_rows
from aerobalance.recording.noise import white_noise
from aerobalance.recording.recording import Recording
from aerobalance.recording.spread_samples import spread_samples
from aerobalance.recording.stuck_samples import stuck_samples


@dataclass(frozen=True, slots=True)
class LoadSettings:
    """Thresholds of the warnings about balance loads.

    Attributes
    ----------
    beyond
        Excess over the calibrated range, over the range, from which it is warned.
    nearly_diverging
        Contraction of the iteration from which it is warned: at 1 the plain iteration no longer converges.
    most_points
        Rows up to which a recording may be averaged points.
    points_apart
        Noise from row to row, over the scatter of the calibration's readings, from which rows are doubted to be
        samples.
    only_noise
        Scatter of a bridge's readings over their white noise up to which they show nothing else.
    by_others
        What the other loads move a bridge by over its scatter, from which on it is dead: a load of its own that takes
        just that off to the noise is none.
    fewest, spread
        Readings from which on bridges are asked, and by how many at least, spread evenly, of what moves them.
    no_bridge
        Output over that at the largest load calibrated, which none reaches in half of the readings: uV/V are a
        thousand times mV/V, and the zero of a bridge is within its range.
    no_load
        The same (rms) which none leaves, where V/V may have been taken for mV/V: zeros of a balance repeat no better.
    shows_more
        Scatter of readings over their white noise from which on they show more than that.
    """

    beyond: float = 0.02
    nearly_diverging: float = 0.5
    most_points: int = 500
    points_apart: float = 20.0
    only_noise: float = 1.2
    by_others: float = 3.0
    fewest: int = 256
    spread: int = 1 << 13
    no_bridge: float = 50.0
    no_load: float = 1e-3
    shows_more: float = 10.0


ROWS_AT_ONCE: Final = 64
"""Rows of a table whose values are compared in one go."""

ROUNDING: Final = 1e-9
"""Scatter of outputs over those at capacity that is rounding."""

MOST_LOST: Final = 0.1
"""Share of the readings of a bridge that rest, up to which all loads are taken for missing there: with more the forces
would be those of the gaps."""

DEAD: Final = 0.9
"""The same from which on the bridge is dead."""

CROWD: Final = 2.0
"""Readings in the last tenth before a limit over those in the tenth before that, from which on they crowd there: the
tails of a load thin out."""

CROWDS_IN_NOISE: Final = 5.0
"""The same over what chance makes of their number."""

NEAR_LIMIT: Final = 0.01
"""Distance from the largest or least reading, over that from the median, within which one rests on a limit."""

SETTINGS: Final = LoadSettings()
"""Thresholds that are used."""


def beyond_range(balance: BalanceMatrix, native: Array) -> dict[str, int]:
    """Samples outside the calibrated range, by the balance's own components; only those that have any.

    Parameters
    ----------
    balance
        The matrix.
    native
        Loads in its own components, shape (n, c); NaN where missing.
    """
    if not native.size:
        return {}
    ends = _excess(balance, np.stack([_along_rows(np.fmin, native), _along_rows(np.fmax, native)]))
    if not (ends > SETTINGS.beyond).any():  # as in most records, which takes a tenth of the time
        return {}
    excess = _excess(balance, native)
    counts = np.count_nonzero(excess > SETTINGS.beyond, axis=0).tolist()
    return {name: count for name, count in zip(balance.components, counts, strict=True) if count}


def _along_rows(ufunc: np.ufunc, table: Array) -> Array:
    """What a function of two values makes of all rows of a table, shape (c,).

    Of a long table in blocks of rows side by side: NumPy works on a row of some hundred values ten times as fast as on
    rows of six.
    """
    rows, columns = table.shape
    whole = rows // ROWS_AT_ONCE
    if whole < 2:
        return np.asarray(ufunc.reduce(table))
    blocks = ufunc.reduce(np.ascontiguousarray(table[: whole * ROWS_AT_ONCE]).reshape(whole, -1))
    rest = table[whole * ROWS_AT_ONCE :]
    return np.asarray(ufunc.reduce(np.concatenate([blocks.reshape(ROWS_AT_ONCE, columns), rest])))


def _excess(balance: BalanceMatrix, native: Array) -> Array:
    """How far loads lie outside the calibrated range, over that range, shape (n, c); negative within."""
    least, most = balance.calibrated
    return np.asarray(np.maximum(native - most, least - native) / (most - least))


def check_range(recording: Recording, balance: BalanceMatrix, native: Array) -> dict[str, int]:
    """Count the samples outside the calibrated range, and warn."""
    counts = beyond_range(balance, native)
    if not counts:
        return counts
    for text in range_texts(recording.name, balance, counts, samples=len(native), excess=excess_of(balance, native)):
        warn_quality(text)
    return counts


def excess_of(balance: BalanceMatrix, native: Array) -> Array:
    """How far loads lie outside the calibrated range at most, over that range, shape (c,); negative within."""
    return np.asarray(_excess(balance, native).max(axis=0))


def range_texts(
    run: str, balance: BalanceMatrix, counts: Mapping[str, int], *, samples: int, excess: Array
) -> Iterator[OfLoads]:
    """What is said of loads of a run outside the calibrated range.

    Parameters
    ----------
    run
        Its name.
    balance
        The matrix.
    counts
        Samples outside, by the balance's own components.
    samples
        Samples that have loads.
    excess
        As `excess_of` returns it.
    """
    for name, least, most, over in zip(balance.components, *balance.calibrated, excess.tolist(), strict=True):
        if counts.get(name):
            yield OfLoads(
                f"{run}: {name} leaves the calibrated range ({least:.4g} to {most:.4g}) in {counts[name]} of "
                f"{samples} samples, by up to {100 * over:.3g} % of it; the matrix is extrapolated there",
                over,
            )


def lost_texts(run: str, lost: int, *, samples: int) -> Iterator[OfLoads]:
    """What is said of samples of a run whose gauge outputs no loads give."""
    if lost:
        yield OfLoads(
            f"{run}: {lost} of {samples} samples have no loads that give their gauge outputs; they are missing in the "
            "result. The outputs lie far outside the calibration",
            lost / samples,
        )


def check_iteration(recording: Recording, balance: BalanceMatrix, native: Array) -> float:
    """Largest contraction factor, looked for where each load is least and largest."""
    columns = np.ascontiguousarray(native.T)
    extremes = np.unique(np.concatenate([columns.argmin(axis=1), columns.argmax(axis=1)]))
    factor = float(np.max(balance.contraction(native[extremes])))
    for text in iteration_texts(recording.name, factor):
        warn_quality(text)
    return factor


def iteration_texts(run: str, factor: float) -> Iterator[OfLoads]:
    """What is said of a run whose largest loads the iteration hardly finds, by its contraction factor."""
    if factor > SETTINGS.nearly_diverging:
        yield OfLoads(
            f"{run}: the interactions are so strong at the largest loads that the iteration shrinks an error only by "
            f"{factor:.2g} a step (at 1 it diverges and loads are not unique); check zeros and units",
            factor,
        )


UNITS_ADVICE: Final = (
    "check the unit of the gauge outputs in the header of the file or in the channel map (mV/V, uV/V, V/V; voltages "
    "with their excitation), and that of the readings of the calibration"
)
"""What to do about outputs that are too large or too small by a large factor."""


def _largest_outputs(balance: BalanceMatrix) -> Array:
    """Outputs at the largest loads calibrated, or at capacity, the larger ones, shape (c,) [mV/V]."""
    reached = np.max(np.abs(balance.calibrated), axis=0) / balance.load_scale
    return np.asarray(balance.output_scale * np.maximum(reached, 1.0))


def check_size(recording: Recording, balance: BalanceMatrix, outputs: Array) -> None:
    """Refuse outputs that no bridge of the balance has, which take minutes to find loads for, and find none.

    Parameters
    ----------
    recording
        The run, or its first part: what comes later may be a failure on the way.
    balance
        The matrix.
    outputs
        Less their zero, shape (n, c) [mV/V]; NaN where missing.

    Raises
    ------
    FitError
        Half of the readings of a bridge are larger than any.
    """
    if recording.extent.begin > 0 or not outputs.size:
        return
    largest = _largest_outputs(balance)
    size, known = np.abs(outputs), np.isfinite(outputs)
    beyond = np.count_nonzero(size > SETTINGS.no_bridge * largest, axis=0)
    wrong = np.flatnonzero(2 * beyond > known.sum(axis=0))
    if not wrong.size:
        return
    over = np.nanmedian(size, axis=0) / largest
    worst = int(wrong[np.argmax(over[wrong])])
    others = f", and so do {wrong.size - 1} bridges more" if wrong.size > 1 else ""
    raise FitError(
        f"{recording.name}: r{balance.gauges[worst]} reads {over[worst] * largest[worst]:.3g} mV/V from its zero in "
        f"the middle of its readings, {over[worst]:.3g} times what it does at the largest load of the calibration, "
        f"which no bridge can{others}: readings or zero are in another unit than was read, such as uV/V as mV/V"
        f"{'' if others else ', or the bridge is open'}; {UNITS_ADVICE}"
    )


def doubts_of_size(readings: Array, balance: BalanceMatrix, components: Sequence[str]) -> Iterator[Doubt]:
    """Return doubts about outputs that move, yet are all next to nothing, one for every component.

    Parameters
    ----------
    readings
        Gauge outputs as they were read, their zeros in them, shape (n, c) [mV/V]; NaN where missing.
    balance
        The matrix.
    components
        Components of the loads.
    """
    whole = whole_rows(readings)
    known = readings if whole.all() else readings[whole]
    if len(known) < SETTINGS.fewest:
        return
    share = share_of_largest(np.einsum("nc,nc->c", known, known) / len(known), balance)
    # noise and zeros of bridges that were set to nothing are as small
    if not is_next_to_nothing(share):
        return
    scatter = known.std(axis=0)
    if not any(own > SETTINGS.shows_more * white_noise(column) for own, column in zip(scatter, known.T, strict=True)):
        return
    text = size_text(share)
    for component in components:
        unit = si_unit(component) if component in COMPONENTS else "N"
        yield Doubt("units", component, text, UNITS_ADVICE, None, unit)


def share_of_largest(squares: Array, balance: BalanceMatrix) -> float:
    """Largest output of a bridge (rms) over that at the largest load calibrated, from mean squares, shape (c,) [1]."""
    return float(np.max(np.sqrt(squares) / _largest_outputs(balance)))


def is_next_to_nothing(share: float) -> bool:
    """Return whether outputs of so much of those at the largest loads are less than zeros repeat."""
    return 0 < share < SETTINGS.no_load


def size_text(share: float) -> str:
    """What is said of bridges that read no more than a share of their outputs at the largest loads."""
    return (
        f"all bridges read {100 * share:.2g} % of their outputs at the largest loads of the calibration (rms), or "
        "less: zeros repeat no better; or the outputs are in another unit than was read, such as V/V as mV/V, and the "
        "loads a thousand times too small"
    )


def check_rows(recording: Recording, balance: BalanceMatrix, channels: Sequence[Channel], noise: Array) -> None:
    """Warn where rows look like averaged points at several loads: what their outputs differ by is no noise."""
    scatter = balance.residual_deviation * balance.output_scale  # of the iterative way, and near enough of the other
    if recording.samples > SETTINGS.most_points or not scatter.any():
        return
    uneven = [
        channel.name
        for channel, own, usual in zip(channels, noise, scatter, strict=True)
        if channel.noise is None and own > SETTINGS.points_apart * usual > 0
    ]
    if uneven:
        warn_quality(
            f"{recording.name}: from row to row {', '.join(uneven)} change by more than {SETTINGS.points_apart:g} "
            "times what readings of the calibration scatter, and that is taken for noise. If the rows are averaged "
            "points at several loads, it is far too large, and the uncertainty with it: say the noise of a row in a "
            'channel map (noise = ... under [channels.rNAME], with "aerobalance map")'
        )


def stuck_outputs(channels: Sequence[Channel], balance: BalanceMatrix) -> NDArray[np.bool_]:
    """Readings of the bridges that repeat the one before, by no chance, shape (n, c).

    None of few readings, or of a bridge that does not move but for rounding.
    """
    found = np.zeros((channels[0].values.size, len(channels)), dtype=np.bool_)
    for place, channel in enumerate(channels):
        known = channel.values[np.isfinite(channel.values)]
        least = ROUNDING * (float(balance.output_scale[place]) if channel.unit == "mV/V" else 0.0)
        if known.size >= SETTINGS.fewest and float(np.ptp(known)) > least:
            found[:, place] = stuck_samples(channel.values)
    return found


def doubts_of_limits(
    readings: Sequence[Array], rests: NDArray[np.bool_], balance: BalanceMatrix, components: Sequence[str]
) -> Iterator[Doubt]:
    """Return doubts about bridges that rest too often to do without, or crowd before a limit, one for each component.

    Parameters
    ----------
    readings
        As the channels have them, shape (n,) each.
    rests
        Which of them repeat the one before or are on a limit of the channel, shape (n, c).
    balance
        The matrix.
    components
        Components of the loads.
    """
    for gauge, values, rest in zip(balance.gauges, readings, rests.T, strict=True):
        share = float(rest.mean())
        if MOST_LOST < share < DEAD:
            text = rest_text(gauge, share)
        elif rest.any() and _crowds(values, rest):
            text = crowd_text(gauge, int(np.count_nonzero(rest)))
        else:
            continue
        for name in components:
            unit = si_unit(name) if name in COMPONENTS else "N"
            yield Doubt("clipping", name, text, "record with a larger range", None, unit)


def rest_text(gauge: str, share: float) -> str:
    """What is said of a bridge of whose readings a share rests."""
    return (
        f"{100 * share:.2g} % of the readings of r{gauge} rest on one value or on a limit: too many to do without, "
        "and all loads are wrong there"
    )


def crowd_text(gauge: str, count: int) -> str:
    """What is said of a bridge whose readings crowd before a value that some of them rest on."""
    return (
        f"readings of r{gauge} crowd before the value that {count} of them rest on: the amplifier limits softly, and "
        "all loads are wrong well before that"
    )


def _crowds(values: Array, rest: NDArray[np.bool_]) -> bool:
    """Whether readings crowd before the largest or least one, on which some rest, all arguments of shape (n,)."""
    middle, there = float(np.nanmedian(values)), np.isfinite(values)
    for end in (float(np.nanmax(values)), float(np.nanmin(values))):
        if end == middle or not (np.abs(values[rest] - end) < NEAR_LIMIT * abs(end - middle)).any():
            continue
        place = (values[there & ~rest] - middle) / (end - middle)
        last, before = (np.count_nonzero((place > low) & (place <= low + 0.1)) for low in (0.9, 0.8))
        if last > CROWD * before + CROWDS_IN_NOISE * np.sqrt(before + 1):
            return True
    return False


def doubts_of_bridges(
    outputs: Array, native: Array, balance: BalanceMatrix, components: Sequence[str], *, sensitivity: Array
) -> Iterator[Doubt]:
    """Return doubts about bridges that read nothing while the other loads move, one for every component.

    A bridge feels the other loads too, as its interactions say. A dead one is read as a load that takes just these
    off, at every instant, and everything that is worked out of its loads looks as if the balance had changed.

    Parameters
    ----------
    outputs
        Gauge outputs, shape (n, c) [mV/V]; NaN where missing.
    native
        Loads in the balance's own components, shape (n, c) [N, N*m].
    balance
        The matrix.
    components
        Components of the loads.
    sensitivity
        Change of the loads in its own components with each output, shape (c, c) [N V/mV].
    """
    known = whole_rows(native) & whole_rows(outputs)
    if np.count_nonzero(known) < SETTINGS.fewest:
        return
    if not known.all():
        outputs, native = outputs[known], native[known]
    whole, some = outputs, spread_samples(len(outputs), SETTINGS.spread)
    outputs, native = outputs[some], native[some]
    scatter = np.sqrt(np.diag(table_covariance(outputs)) * (1 - 1 / len(outputs)))
    moves = np.linalg.inv(sensitivity)
    np.fill_diagonal(moves, 0.0)
    by_others = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", moves, table_covariance(native), moves), 0.0))
    least = np.maximum(SETTINGS.by_others * scatter, ROUNDING * balance.output_scale)
    for place in np.flatnonzero(by_others > least):
        still = scatter[place] < ROUNDING * balance.output_scale[place]
        if not still and scatter[place] > SETTINGS.only_noise * white_noise(whole[:, place]):
            continue
        same = "reads the same all along" if still else "shows nothing but noise"
        text = (
            f"r{balance.gauges[place]} {same} ({scatter[place]:.2g} mV/V rms), where the other loads alone would move "
            f"it by {by_others[place]:.2g} mV/V: the bridge is dead or not connected, and the loads are wrong"
        )
        for name in components:
            unit = si_unit(name) if name in COMPONENTS else "N"
            yield Doubt("stuck channel", name, text, "look at the bridge, its cable and its amplifier", None, unit)


def doubt_texts(run: str, doubts: Sequence[Doubt]) -> Iterator[OfLoads]:
    """What is said of the doubts about loads of a run: one sentence for all components."""
    for text in dict.fromkeys(str(doubt) for doubt in doubts):
        yield OfLoads(f"{run}: {text}")
