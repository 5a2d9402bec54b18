"""Lines at frequencies of the mains that are taken for force, and may be hum."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from aerobalance.estimation.error_sources import Noise
from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.estimation.record import ComponentRecord
from aerobalance.estimation.signal_model import LARGEST_HUM
from aerobalance.estimation.spectra.line_noise import (
    LINE_EVIDENCE,
    MAINS,
    MAINS_TOLERANCE,
    MOST_HARMONICS,
    strongest_line,
)
from aerobalance.estimation.spectra.lines import Line, columns_of_lines
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import Assumption, Doubt
from aerobalance.recording.errors import argument, warn_quality

NARROW: Final = 0.05
"""Width of a band over its frequency up to which it may be hum that drifts, told badly by a short record."""

DRIFTS: Final = 0.02
"""Width of the band in which hum drifts, over its frequency, at most."""

LOBES: Final = 4.0
"""Ordinates over which a Hann window spreads a line: by so much a band may be wider; more than `NARROW` only where its
frequency is named."""

NEAR: Final = 0.01
"""Relative distance from a multiple of the mains' frequency up to which it may be."""

STANDS_OUT: Final = 3.0
"""Level over those beside it from which it is a band of its own."""

LEAST: Final = 1e-3
"""Root mean square of an error over that of the noise below which nothing is said of it."""

BINS: Final = 4096
"""Frequencies at which the spectrum of an error is kept: a line is narrow."""

FORCE_ODDS: Final = 0.5
"""Probability that a line within the band of a load is force: nothing but its frequency speaks for hum."""

COUNTS: Final = 0.1
"""Rms of a hidden harmonic over the rest of the uncertainty from which on it is counted."""


def hum_doubts(
    reading: Observation,
    learned: SpectralPrior,
    left: Array,
    *,
    named: Sequence[float],
    large: Sequence[Line],
    of_load: Sequence[Line] = (),
    unit: str,
) -> list[tuple[Doubt, Noise]]:
    """Doubts about lines that are taken for force, each with what it does to the force if it is hum.

    Parameters
    ----------
    reading, learned
        The record, and what was learned of the force.
    left
        Readings without the steps and the lines that were found, 0 where missing, shape (n,) [N].
    named
        Frequencies that were named as hum, of which a line that drifts leaves a part; none to look where the mains are
        [Hz].
    large
        Lines at frequencies of the mains that are a large part of the record.
    of_load
        Lines there that are harmonics of a load that repeats.
    unit
        Unit of the force.
    """
    dynamics, count, interval = reading.dynamics, reading.values.size, reading.interval
    component, found = dynamics.component, []
    for line in large:
        gain = float(np.abs(dynamics.response(np.array([line.frequency])))[0])
        size = f"{line.amplitude:.3g} {unit} in the reading"
        found.append(
            (f"a line at {line.frequency:.5g} Hz ({size})", line.frequency, line.amplitude / gain / np.sqrt(2))
        )
    if not large:
        places = np.array(named) if named else np.outer(MAINS, np.arange(1, MOST_HARMONICS + 1)).ravel()
        spread = LOBES / (count * interval)
        shown = np.where(reading.present, left, np.nan)  # zeros in a gap would spread a line
        found += [
            (f"a narrow band at {middle:.4g} Hz", middle, rms)
            for low, high, rms in _narrow_bands(learned, interval, spread=spread, named=bool(named))
            for middle in _places_of_hum(shown, interval, (low, high), places, named=bool(named))
            if not any(abs(middle / line.frequency - 1) < NARROW for line in of_load)
        ]
    where = "hum was named" if named else "the mains are"
    return [
        (
            Doubt(
                "hum",
                component,
                f"{component} shows {what}, where {where}: it is taken for a force of {rms:.2g} {unit} rms, and "
                "is an error of that size if it is hum",
                f"if it is hum, shield the cables, or name a steady line with {argument('hum')}; if it is force, keep "
                f"it with {argument('hum', 'keep')}",
                rms,
                unit,
            ),
            _error(component, frequency, rms, count=count, interval=interval),
        )
        for what, frequency, rms in found
    ]


def hidden_harmonics(
    reading: Observation, learned: SpectralPrior, left: Array, *, lines: Sequence[Line], of_load: Sequence[Line] = ()
) -> list[tuple[float, float]]:
    """Frequencies [Hz] of harmonics of hum that a force may hide, each with its rms as an error of the force [N].

    Lines of hum tell its frequency. At each other multiple the reading has the amplitude a of a line with the variance
    V of what else is there, so that with the variance P of an amplitude before it was read, its mean square is
    (P a / (P + V))^2 + P V / (P + V). Of that the force has the part that is not taken for noise. P is that of the
    lines that are seen, as harmonics of a current with jumps are: their amplitudes fall as one over their number.

    Parameters
    ----------
    reading, learned
        The record, and what was learned of it.
    left
        Readings without the steps and the lines that were found, 0 where missing, shape (n,) [N].
    lines
        Lines that are taken for hum of the mains.
    of_load
        Lines there that are harmonics of a load that repeats.
    """
    if not lines:
        return []
    leader = max(lines, key=lambda line: line.evidence)
    # a twentieth harmonic at 0.1 % off its place still has its own number
    _, mains = min((abs(leader.frequency / one - round(leader.frequency / one)) * one, one) for one in MAINS)
    fundamental = leader.frequency / round(leader.frequency / mains)
    known = [*lines, *of_load]
    numbers = np.array(
        [
            number
            for number in range(1, MOST_HARMONICS + 1)
            if number * fundamental < 0.5 / reading.interval
            and not any(abs(number * fundamental / line.frequency - 1) < NEAR for line in known)
        ]
    )
    if not numbers.size:
        return []
    frequencies = fundamental * numbers
    window = np.hanning(left.size + 2)[1:-1] * reading.present
    window /= window.sum()
    columns = columns_of_lines(frequencies.tolist(), count=left.size, interval=reading.interval)
    parts = 2 * (window * (left - window @ left)) @ columns
    read = parts[0::2] ** 2 + parts[1::2] ** 2
    gain = np.abs(reading.dynamics.response(frequencies)) ** 2
    force, noise = gain * learned.spectrum.density(frequencies), learned.noise**2 * reading.interval
    other = 4 * (force + noise) / reading.interval * float(window @ window)
    before = (max(line.amplitude * round(line.frequency / fundamental) for line in lines) / numbers) ** 2
    square = (before / (before + other)) ** 2 * read + before * other / (before + other)
    rms = force / (force + noise) * np.sqrt(square / (2 * gain))
    return [(float(frequency), float(size)) for frequency, size in zip(frequencies, rms, strict=True)]


def hidden_doubts(
    component: str, hidden: Sequence[tuple[float, float]], *, rest: float, count: int, interval: float, unit: str
) -> tuple[Doubt | None, list[Noise]]:
    """The doubt about harmonics of hum that a force may hide, if they are most of the uncertainty, and their errors.

    Parameters
    ----------
    component
        Which it is.
    hidden
        Frequency [Hz] and rms [N] of each.
    rest
        Rms of the uncertainty by everything else [N].
    count, interval
        Samples of the record, and time between them [s].
    unit
        Unit of the force.
    """
    counted = [one for one in hidden if one[1] > COUNTS * rest]
    errors = [_error(component, frequency, rms, count=count, interval=interval) for frequency, rms in counted]
    effect = float(np.sqrt(sum(rms**2 for _, rms in counted)))
    if not effect > rest:
        return None, errors
    where = ", ".join(f"{frequency:.5g}" for frequency, _ in counted)
    text = (
        f"{component} has hum of the mains, of which a force may hide more at {where} Hz: by what is read there, and "
        "as strong as harmonics that fall as one over their number from those that are seen, it may be an error of "
        f"{effect:.2g} {unit} rms; that is in the uncertainty"
    )
    advice = (
        f"shield the cables, or give a record of noise with {argument('noise')}, which shows the hum; if the steady "
        f"lines are force, keep them with {argument('hum', 'keep')}"
    )
    return Doubt("hum", component, text, advice, effect, unit), errors


def lines_within_load(
    reading: Observation, learned: SpectralPrior, *, lines: Sequence[Line], unit: str
) -> Iterator[tuple[Doubt, Noise]]:
    """Yield doubts about lines that are taken for hum though they stand within the load's band, and their errors.

    There a line is seen only if it is far stronger than noise of the electronics, and a tone of the load, as of a
    vortex street or a rotor, is as likely.

    Parameters
    ----------
    reading, learned
        The record, and what was learned of it beside the lines.
    lines
        Lines that are taken for hum of the mains.
    unit
        Unit of the force.
    """
    component = reading.dynamics.component
    for line in lines:
        place = np.array([line.frequency])
        gain = float(np.abs(reading.dynamics.response(place))[0])
        felt = gain**2 * float(learned.spectrum.density(place)[0])
        if felt < learned.noise**2 * reading.interval:
            continue
        as_force = line.amplitude / gain / np.sqrt(2)
        rms = float(np.sqrt(FORCE_ODDS) * as_force)
        text = (
            f"{component} has a line at {line.frequency:.5g} Hz ({line.amplitude:.3g} {unit} in the reading) within "
            f"the band of its load: it is taken for hum of the mains, and a force of {as_force:.2g} {unit} rms looks "
            f"the same; {rms:.2g} {unit} rms of the uncertainty are for that"
        )
        advice = (
            f"a record of noise alone ({argument('noise')}) shows hum; if it is force, keep it with "
            f"{argument('hum', 'keep')}"
        )
        error = _error(component, line.frequency, rms, count=reading.values.size, interval=reading.interval)
        yield Doubt("hum", component, text, advice, rms, unit), error


def hum_assumed(reading: Observation, learned: SpectralPrior, *, unit: str) -> Iterator[Assumption]:
    """Yield that there is no mains hum where a force hides it, with what a line as strong as the white noise would do.

    Parameters
    ----------
    reading, learned
        The record, and what was learned of it.
    unit
        Unit of the force.
    """
    mains = np.array([one for one in MAINS if one < 0.5 / reading.interval])
    gain = np.abs(reading.dynamics.response(mains)) ** 2
    force = gain * learned.spectrum.density(mains)
    noise = learned.noise**2 * reading.interval
    # under a Hann window a line of amplitude a has a^2 n dt / 6 of the power at its ordinate, and three times that is
    # its evidence
    lasts = np.count_nonzero(reading.present) * reading.interval
    hidden = learned.noise**2 * lasts / (force + noise) < LINE_EVIDENCE
    effect = np.where(hidden, learned.noise / np.sqrt(gain) * force / (force + noise), 0.0)
    worst = int(np.argmax(effect)) if mains.size else 0
    if not mains.size or not effect[worst] > LEAST * learned.noise:
        return
    name, size = reading.dynamics.component, float(effect[worst])
    text = (
        f"{name} has no hum where a force hides it: a line at {mains[worst]:g} Hz with the rms of its white noise, "
        f"{learned.noise:.2g} {unit}, would change the force by {size:.2g} {unit} rms"
    )
    yield Assumption("hum", name, text, size, unit)


def _error(component: str, frequency: float, rms: float, *, count: int, interval: float) -> Noise:
    density = np.zeros(BINS)
    density[min(round(2 * frequency * interval * (BINS - 1)), BINS - 1)] = BINS
    return Noise(f"hum at {frequency:.4g} Hz", component, np.full(count, rms), density)


def _narrow_bands(
    learned: SpectralPrior, interval: float, *, spread: float, named: bool
) -> Iterator[tuple[float, float, float]]:
    """Edges [Hz] and rms [N] of bands of the force as narrow as hum, which the window spreads by a width [Hz].

    `named` is whether the frequencies of hum are.
    """
    spectrum = learned.spectrum
    if spectrum.roll_off:
        return
    edges, levels = np.append(0.0, spectrum.edges), np.concatenate([[0.0], spectrum.levels, [0.0]])
    for place, level in enumerate(spectrum.levels):
        low, high = float(edges[place]), min(float(edges[place + 1]), 0.5 / interval)
        beside = float(max(levels[place], levels[place + 2]))
        middle = (low + high) / 2
        most = NARROW * middle + spread if named else min(NARROW * middle, DRIFTS * middle + spread)
        if level > STANDS_OUT * beside and high - low <= most:
            yield low, high, float(np.sqrt(2 * (level - beside) * (high - low)))


def _places_of_hum(
    left: Array, interval: float, band: tuple[float, float], places: Array, *, named: bool
) -> Iterator[float]:
    """Yield where a narrow band of the force may be hum [Hz]: nowhere or at one frequency.

    Parameters
    ----------
    left
        Readings without the steps and the lines that were found, NaN where missing, shape (n,) [N].
    interval
        Time between samples [s].
    band
        Its edges [Hz].
    places
        Frequencies of hum, shape (m,) [Hz].
    named
        Whether they were named: then one within the edges is enough.
    """
    low, high = band
    middle, inside = (low + high) / 2, bool(np.any((low < places) & (places < high)))
    # of a faint band the edges are told badly; every second one would hold some multiple of the mains
    if named and inside:
        yield middle
    elif np.min(np.abs(middle / places - 1)) < NEAR:
        line = strongest_line(left, interval, low=low, high=high)
        if line is None:  # hum that drifts is no steady line
            yield middle
        elif np.min(np.abs(line.frequency / places - 1)) < MAINS_TOLERANCE + 4 * line.u_frequency / line.frequency:
            yield line.frequency


def unknown_lines(record: ComponentRecord, large: Sequence[Line]) -> tuple[Line, ...]:
    """Return those lines at frequencies of the mains, taken for force, that the record of noise does not show as well.

    Parameters
    ----------
    record
        The component made ready.
    large
        Lines that are too large a part of the record to be taken for hum.
    """
    known = () if record.noise is None else record.noise.hum
    resolved = 1 / (record.load.size * record.interval)
    return tuple(
        line
        for line in large
        if not any(abs(line.frequency - hum.frequency) < resolved + hum.width * hum.frequency for hum in known)
    )


def driven_lines(record: ComponentRecord, large: Sequence[Line]) -> tuple[Line, ...]:
    """Return those of them that are so large that nobody would record such hum."""
    largest = LARGEST_HUM * float(np.nanmax(np.abs(record.load)))
    return tuple(line for line in unknown_lines(record, large) if line.amplitude > largest)


def tell_of_hum(record: ComponentRecord, lines: tuple[Line, ...], *, driven: tuple[Line, ...]) -> None:
    """Say which lines at frequencies of the mains are not in the force, and which are, as they are a drive."""
    told = (
        (
            lines,
            (
                "are taken for mains hum and not for force; if a force was applied at such a frequency it is missing "
                f"from the result: keep it with {argument('hum', 'keep')}"
            ),
        ),
        (
            driven,
            (
                "lie where the mains do, but are so large a part of the record that they are taken for force; if they "
                f"are hum, the force is wrong by them: name their frequencies with {argument('hum')}"
            ),
        ),
    )
    unit = si_unit(record.dynamics.component)
    for some, what in told:
        named = [f"{line.frequency:.7g} Hz ({line.amplitude:.3g} {unit} in the reading)" for line in some]
        if named:
            warn_quality(
                f"{record.recording.name}: steady lines of {record.dynamics.component} at {', '.join(named)} {what}"
            )
