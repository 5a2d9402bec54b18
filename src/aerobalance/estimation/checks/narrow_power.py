"""Narrow power of the readings above the natural frequency, which may be a force or an interference.

Where the balance weakens a force no spectrum is learned that is higher than elsewhere: what an interference, another
mode or a shock shows there would be taken for a force, and enlarged by 1 / |G|. A tone of the load, or a narrow band
of it, may then be missing from the force; or, where one is taken for a force that is larger than all else, it may be
none. Either counts in the uncertainty by its probability. One that is taken for a force of usual size is assumed to
be one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.modal import Mode
from aerobalance.estimation.error_sources import Noise
from aerobalance.estimation.force_smoother import SmootherResult
from aerobalance.estimation.prior import periodogram_of
from aerobalance.estimation.signal_model import LARGEST_HUM
from aerobalance.estimation.spectra.load_tones import near_mains
from aerobalance.estimation.spectra.noise_candidates import narrow_bands, standing_out
from aerobalance.estimation.spectra.periodogram import Periodogram
from aerobalance.estimation.spectra.piecewise_psd import WEAKENED
from aerobalance.estimation.spectra.windows import HANN_WIDTH, share_seen
from aerobalance.estimation.statespace.kalman import LOAD
from aerobalance.recording.channel import Array
from aerobalance.recording.doubts import Assumption, Doubt
from aerobalance.recording.errors import argument


@dataclass(frozen=True, slots=True)
class NarrowSettings:
    """Thresholds and prior probabilities of power that may be force or interference; these are chosen.

    Attributes
    ----------
    stands_out
        Density of a force over that on either side from which on it is a band of its own.
    force
        Probability that it is a force.
    larger
        Size as a force over all other force, beyond which that is less likely, as its square; a line that is a large
        part of the readings is what was recorded, and may have any size.
    beside
        Half widths of a mode's resonance within which a band is that.
    """

    stands_out: float = 2.0
    force: float = 0.5
    larger: float = 2.0
    beside: float = 4.0


SETTINGS: Final = NarrowSettings()
"""Settings that are used."""

FORCE_OR_INTERFERENCE: Final = "what may be force or interference"
"""Name of the error."""

BINS: Final = 4096
"""Frequencies from zero to half the sampling rate at which the spectrum of the error is kept."""


class _Band(NamedTuple):
    """A narrow band.

    Attributes
    ----------
    first, last
        Its edges [Hz].
    in_reading, as_force
        Mean square in the reading, and as a force [N^2].
    taken
        Whether it is taken for a force.
    usual
        Whether it may be a force whatever its size, or is no larger than usual.
    probability
        Probability that it is a force [1].
    """

    first: float
    last: float
    in_reading: float
    as_force: float
    taken: bool
    usual: bool
    probability: float


@dataclass(frozen=True, slots=True, eq=False)
class NarrowPower:
    """Narrow bands that are taken for interference or for force, and may be the other.

    Attributes
    ----------
    bands
        The bands, all of them taken for the same.
    density
        Spectrum of the error at even frequencies from zero to half the sampling rate, its mean 1 [1].
    missing
        Root of the expected mean square of the error [N].
    """

    bands: tuple[_Band, ...]
    density: Array
    missing: float

    @classmethod
    def of(cls, bands: list[_Band], *, interval: float) -> NarrowPower:
        """Take bands of readings a time apart [s], of which there is one at least."""
        frequency = np.linspace(0, 0.5 / interval, BINS + 1)[1:]
        density = np.zeros(BINS)
        for one in bands:
            wrong = 1 - one.probability if one.taken else one.probability
            near = np.searchsorted(frequency, np.linspace(one.first, one.last, 33))
            np.add.at(density, np.minimum(near, BINS - 1), wrong * one.as_force / near.size)
        return cls(tuple(bands), density / np.mean(density), float(np.sqrt(np.sum(density))))

    def error(self, component: str, *, count: int) -> Noise:
        """Contribution to the uncertainty of a force of so many samples, of a component [N]."""
        return Noise(FORCE_OR_INTERFERENCE, component, np.full(count, self.missing), self.density)

    def doubt(self, component: str, *, unit: str) -> Doubt:
        """Doubt that it may be the other."""
        strongest = max(self.bands, key=lambda one: one.as_force)
        in_reading, as_force = (
            float(np.sqrt(sum(getattr(one, what) for one in self.bands))) for what in ("in_reading", "as_force")
        )
        seen = (
            f"{component} shows {in_reading:.2g} {unit} rms in narrow bands, the strongest at "
            f"{(strongest.first + strongest.last) / 2:.4g} Hz, "
        )
        if strongest.taken:
            seen += (
                f"which are taken for a force of {as_force:.2g} {unit} rms: as that is larger than all other force, "
                f"an interference of the electronics is likelier (probability {1 - strongest.probability:.2g})"
            )
        else:
            seen += (
                "which neither its force nor its noise has: they are taken for an interference of the electronics "
                f"and not for a force of {as_force:.2g} {unit} rms, which would look the same and is then missing "
                f"from the result (probability {strongest.probability:.2g})"
            )
        seen += f"; {self.missing:.2g} {unit} rms of the uncertainty are for that"
        advice = (
            "look for it in a record without load: a steady line that is there as well is named with "
            f"{argument('hum')}; a force there wants a balance with a higher natural frequency"
        )
        return Doubt("interference", component, seen, advice, self.missing, unit)


def narrow_power(fit: SmootherResult, modes: Sequence[Mode]) -> list[NarrowPower]:
    """Return narrow power that may be force or interference, of what is left out and of what is taken for a force.

    Parameters
    ----------
    fit
        The force by the smoother.
    modes
        All modes of the balance: what a component shows beside one is what its row leaves of the others.
    """
    seen = _Seen.of(fit)
    if seen is None:
        return []
    left_out = list(_bands(fit, seen, standing_out(seen.periodogram, seen.load, seen.background), modes, taken=False))
    unusual = [one for one in _bands(fit, seen, _taken(fit), modes, taken=True) if not one.usual]
    return [NarrowPower.of(some, interval=fit.reading.interval) for some in (left_out, unusual) if some]


def interference_assumed(
    fit: SmootherResult, component: str, modes: Sequence[Mode], *, unit: str
) -> Iterator[Assumption]:
    """Yield that narrow bands above the natural frequency are a force, where they are taken for one of usual size.

    Parameters
    ----------
    fit, modes
        As of `narrow_power`.
    component, unit
        Component whose force is meant, and unit of that.
    """
    edges = list(_taken(fit))
    seen = _Seen.of(fit) if edges else None
    if seen is None:
        return
    usual = [one for one in _bands(fit, seen, edges, modes, taken=True) if one.usual]
    if not usual:
        return
    strongest = max(usual, key=lambda one: one.as_force)
    effect = float(np.sqrt(sum(one.as_force for one in usual)))
    text = (
        f"what {component} shows at {(strongest.first + strongest.last) / 2:.4g} Hz is a force and no interference of "
        f"the electronics, which would look the same: it is {effect:.2g} {unit} rms of the force"
    )
    yield Assumption("interference", component, text, effect, unit)


class _Seen(NamedTuple):
    """The averaged periodogram of what is left of the readings, and what is expected of it.

    Attributes
    ----------
    periodogram
        Of the readings without constant, steps, tones and hum, gaps bridged.
    share
        Share of the readings that it sees [1].
    force, load, background
        Density of the force that was learned, of its load, and of noise, shape (m,) each [N^2/Hz].
    """

    periodogram: Periodogram
    share: float
    force: Array
    load: Array
    background: Array

    @classmethod
    def of(cls, fit: SmootherResult) -> _Seen | None:
        """Take the readings of a force; None where they have no noise."""
        reading, learned = fit.reading, fit.learned
        if not learned.noise > 0:
            return None
        share = share_seen(reading.present)
        left = np.where(reading.present, reading.filled - fit.columns @ fit.sizes, fit.states[:, LOAD])
        seen = periodogram_of(reading, left - left.mean(), share=share)
        background = seen.background(share * learned.noise**2 * reading.interval)
        return cls(seen, share, learned.spectrum.density(seen.frequency), seen.load(learned.spectrum), background)


def _bands(
    fit: SmootherResult,
    seen: _Seen,
    edges: Iterable[tuple[float, float]],
    modes: Sequence[Mode],
    *,
    taken: bool,
) -> Iterator[_Band]:
    """What narrow bands between edges [Hz] are, but those of hum and of modes; all are taken for a force, or none."""
    periodogram, values = seen.periodogram, fit.reading.values[fit.reading.present]
    power, step = np.maximum(periodogram.density - seen.background, 0.0), periodogram.step
    known = _power_within(periodogram, seen.force, slice(None)) + float(np.mean(values)) ** 2
    recorded = 0.5 * (LARGEST_HUM * float(np.ptp(values)) / 2) ** 2
    for first, last in edges:
        if near_mains(np.array([(first + last) / 2]), ordinate=step)[0] or _of_mode(first, last, modes):
            continue
        frequency = periodogram.frequency
        inside = (frequency > first - HANN_WIDTH * step) & (frequency < last + HANN_WIDTH * step)
        in_reading, as_force = (
            _power_within(periodogram, one, inside) / seen.share for one in (power, power / periodogram.gain)
        )
        if not as_force > 0:
            continue
        others = max(known - _power_within(periodogram, seen.force, inside), 0.0)
        larger = SETTINGS.larger**2 * others / as_force
        usual = in_reading > recorded or larger > 1
        probability = SETTINGS.force * (1.0 if usual else larger)
        yield _Band(first, last, in_reading, as_force, taken, usual, probability)


def _of_mode(first: float, last: float, modes: Sequence[Mode]) -> bool:
    """Whether a band between two frequencies [Hz] lies beside one of some modes."""
    reach = [(mode.natural_frequency, SETTINGS.beside * mode.damping_ratio) for mode in modes]
    return any(first < centre * (1 + half) and last > centre * (1 - half) for centre, half in reach)


def _power_within(seen: Periodogram, density: Array, inside: NDArray[np.bool_] | slice) -> float:
    """Mean square of a two-sided density, (m,) [N^2/Hz], within some averages [N^2]."""
    return float(2 * seen.step * np.sum((density * seen.count)[inside]))


def _taken(fit: SmootherResult) -> Iterator[tuple[float, float]]:
    """Edges of narrow bands of the force that stand out of what is beside them, where the balance weakens it [Hz]."""
    spectrum = fit.learned.spectrum
    if spectrum.roll_off or spectrum.tail is not None:
        return
    beside = np.concatenate([[0.0], spectrum.levels, [0.0]])
    firsts = np.append(0.0, spectrum.edges)[:-1]
    stands_out = spectrum.levels > SETTINGS.stands_out * np.maximum(beside[:-2], beside[2:])
    weakened = np.abs(fit.reading.dynamics.response(firsts)) ** 2 < WEAKENED
    yield from narrow_bands(spectrum, stands_out & weakened)
