"""Narrow power of the readings above the natural frequency, which may be a force or an interference.

Where the balance weakens a force no spectrum is learned that is higher than elsewhere: what an interference, another
mode or a shock shows there would be taken for a force, and enlarged by 1 / |G|. A tone of the load, or a narrow band
of it, may then be missing from the force; or, where one is taken for a force that is larger than all else, it may be
none. Either counts in the uncertainty by its probability. One that is taken for a force of usual size is assumed to
be one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.modal import ModalModel, Mode
from aerobalance.estimation.error_sources import Noise
from aerobalance.estimation.force_smoother import SmootherResult
from aerobalance.estimation.prior import SpectralPrior, periodogram_of
from aerobalance.estimation.spectra.line_noise import MAINS
from aerobalance.estimation.spectra.noise_candidates import without_balance
from aerobalance.estimation.spectra.periodogram import Periodogram
from aerobalance.estimation.spectra.piecewise_psd import WEAKENED, fit_segments, pruned
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
    evidence
        Logarithm of the likelihood that a band must bring, as one of the force must elsewhere.
    widest
        Width of a band over its frequency up to which it is narrow: broad ones are compared as force and as noise.
    stands_out
        Density of a force over that on either side from which on it is a band of its own.
    force
        Prior probability that it is a force.
    larger
        Size as a force over all other force, beyond which that is less likely, as its square.
    recorded
        Amplitude over half the span of the readings from which on it is what was recorded, and may have any size.
    beside
        Half widths of a mode's resonance within which a band is that.
    mains
        Distance from a multiple of 50 or 60 Hz, over that, within which it is asked as hum.
    """

    evidence: float = 25.0
    widest: float = 0.1
    stands_out: float = 2.0
    force: float = 0.5
    larger: float = 2.0
    recorded: float = 0.1
    beside: float = 4.0
    mains: float = 0.01


SETTINGS: Final = NarrowSettings()
"""Settings that are used."""

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
        return Noise("what may be force or interference", component, np.full(count, self.missing), self.density)

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
            "look for it in a record without load: where it is there as well, name a steady line with "
            f"{argument('hum')}, or give that record as the noise ({argument('noise')}); a force there wants a "
            "balance with a higher natural frequency"
        )
        return Doubt("interference", component, seen, advice, self.missing, unit)


def narrow_power(fit: SmootherResult, modes: Sequence[Mode]) -> list[NarrowPower]:
    """Return narrow power that may be force or interference, of what is left out and of what is taken for a force.

    Parameters
    ----------
    fit
        The force by the smoother, without a doubt about such power.
    modes
        All modes of the balance: what a component shows beside one is what its row leaves of the others.
    """

    def of_mode(band: _Band) -> bool:
        return any(
            band.first < mode.natural_frequency * (1 + SETTINGS.beside * mode.damping_ratio)
            and band.last > mode.natural_frequency * (1 - SETTINGS.beside * mode.damping_ratio)
            for mode in modes
        )

    bands = [one for one in _bands(fit) if not of_mode(one)]
    apart = [one for one in bands if not one.taken], [one for one in bands if one.taken and not one.usual]
    return [NarrowPower.of(some, interval=fit.reading.interval) for some in apart if some]


def interference_assumed(fit: SmootherResult, component: str, *, unit: str) -> Iterator[Assumption]:
    """Yield that narrow bands above the natural frequency are a force, where they are taken for one of usual size.

    Parameters
    ----------
    fit
        The force by the smoother.
    component, unit
        Component whose force is meant, and unit of that.
    """
    taken = [one for one in _bands(fit, taken=True) if one.usual]
    if not taken:
        return
    strongest = max(taken, key=lambda one: one.as_force)
    effect = float(np.sqrt(sum(one.as_force for one in taken)))
    text = (
        f"what {component} shows at {(strongest.first + strongest.last) / 2:.4g} Hz is a force and no interference of "
        f"the electronics, which would look the same: it is {effect:.2g} {unit} rms of the force"
    )
    yield Assumption("interference", component, text, effect, unit)


def _bands(fit: SmootherResult, *, taken: bool = False) -> Iterator[_Band]:
    """Narrow bands where the balance weakens a force; of those alone that are taken for one, if so asked."""
    reading, learned = fit.reading, fit.learned
    edges = list(_taken(learned, reading.dynamics))
    if not learned.noise > 0 or (taken and not edges):
        return
    share = share_seen(reading.present)
    left = np.where(reading.present, reading.filled - fit.columns @ fit.sizes, fit.states[:, LOAD])
    seen = periodogram_of(reading, left - left.mean(), share=share)
    force, load = learned.spectrum.density(seen.frequency), seen.load(learned.spectrum)
    background = seen.background(share * learned.noise**2 * reading.interval)
    found = [(*one, True) for one in edges]
    if not taken:
        hidden = (seen.gain < WEAKENED) & (load < background)
        found += [(*one, False) for one in _standing_out(seen, hidden, load + background)]
    power, span = np.maximum(seen.density - background, 0.0), float(np.ptp(reading.values[reading.present]))
    known = _power_within(seen, force, np.full(force.size, True)) + float(np.mean(reading.filled)) ** 2
    for first, last, as_load in found:
        middle = (first + last) / 2
        if any(abs(middle / (max(round(middle / one), 1) * one) - 1) < SETTINGS.mains for one in MAINS):
            continue
        inside = (seen.frequency > first - HANN_WIDTH * seen.step) & (seen.frequency < last + HANN_WIDTH * seen.step)
        in_reading, as_force = (_power_within(seen, one, inside) / share for one in (power, power / seen.gain))
        others = max(known - _power_within(seen, force, inside), 0.0)
        recorded = np.sqrt(2 * in_reading) > SETTINGS.recorded * span / 2
        usual = bool(recorded or as_force < SETTINGS.larger**2 * others)
        if as_force > 0:
            probability = SETTINGS.force * (1.0 if usual else SETTINGS.larger**2 * others / as_force)
            yield _Band(first, last, in_reading, as_force, as_load, usual, probability)


def _power_within(seen: Periodogram, density: Array, inside: NDArray[np.bool_]) -> float:
    """Mean square of a two-sided density, (m,) [N^2/Hz], within some averages, (m,) [N^2]."""
    return float(2 * seen.step * np.sum((density * seen.count)[inside]))


def _taken(learned: SpectralPrior, dynamics: ModalModel) -> Iterator[tuple[float, float]]:
    """Edges of narrow bands of the force that stand out of what is beside them, where the balance weakens it [Hz]."""
    spectrum = learned.spectrum
    if spectrum.roll_off or spectrum.tail is not None:
        return
    levels = np.concatenate([[0.0], spectrum.levels, [0.0]])
    firsts = np.append(0.0, spectrum.edges)[:-1]
    weakened = np.abs(dynamics.response(firsts)) ** 2 < WEAKENED
    for place, (first, last) in enumerate(zip(firsts.tolist(), spectrum.edges.tolist(), strict=True), start=1):
        beside = max(levels[place - 1], levels[place + 1])
        narrow = last - first < SETTINGS.widest * last
        if weakened[place - 1] and narrow and levels[place] > SETTINGS.stands_out * beside:
            yield first, last


def _standing_out(seen: Periodogram, where: NDArray[np.bool_], model: Array) -> Iterator[tuple[float, float]]:
    """Edges of narrow bands that stand out of what is expected of the reading, (m,), in some averages, (m,) [Hz]."""
    if not where.any():
        return
    alone = replace(without_balance(seen, where), color=np.repeat(model, seen.count))
    found = fit_segments(alone, 0.0)
    found = pruned(found, alone, lambda power: alone.log_likelihood(power, 0.0), worth=SETTINGS.evidence)
    firsts = np.append(0.0, found.edges)[:-1]
    for first, last, level in zip(firsts.tolist(), found.edges.tolist(), found.levels.tolist(), strict=True):
        if level > 0 and last - first < SETTINGS.widest * last:
            yield first, last
