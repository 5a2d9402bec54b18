"""Spectra of a shaken record: what the ground end did, what the balance felt, and how loud each channel's noise is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft, rfftfreq

from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import STANDARD_GRAVITY, driving_axis, driving_channel, other_end
from aerobalance.recording.errors import FitError, warn_quality
from aerobalance.recording.fourier import without_line
from aerobalance.recording.gravity import gravity_share
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import interpolate_gaps_linearly

Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class SpectraSettings:
    """Sizes and thresholds of the spectra of a shaken record.

    Attributes
    ----------
    least_samples
        Samples below which no spectrum of use can be had.
    least_lines
        Frequencies below which a band tells nothing.
    least_coherence
        Coherence below which a block of frequencies tells more about noise than about the balance.
    windowed
        Neighbouring powers of a Hann-windowed transform that count as one independent power.
    swept
        Level by the median over level by the mean, between that of noise, 1, and that of a swept sine, 1 / ln 2 =
        1.44.
    longest_bridge
        Missing samples in a row that are bridged by a straight line.
    """

    least_samples: int = 256
    least_lines: int = 32
    least_coherence: float = 0.1
    windowed: float = 35 / 18
    swept: float = 1.18
    longest_bridge: int = 3


SETTINGS: Final = SpectraSettings()
"""Thresholds that are used."""


@dataclass(frozen=True, slots=True, eq=False)
class Spectra:
    """Discrete Fourier transforms of one record at the frequencies kept, divided by the root of the sample number.

    White noise of standard deviation s then has the expected power s^2 at every frequency.

    Attributes
    ----------
    frequency
        Frequencies, shape (m,) [Hz].
    load
        Transform of the load, known delay removed, shape (m,).
    ground
        Transform of the ground's specific force along the component, shape (m,) [m/s^2]; x1'' - g sin(pitch) for AF.
    live
        Transform of the live end's acceleration likewise, or None.
    load_noise, ground_noise
        Expected power of the noise of both, shape (m,).
    ground_noise_given
        Whether the channel's settings give the latter, or the quietest part of its spectrum.
    block
        Number of the block of neighbouring frequencies that each belongs to, shape (m,), counted from 0.
    samples
        Number of samples behind the transform.
    span
        Duration of the record [s].
    """

    frequency: Array
    load: Complex
    ground: Complex
    live: Complex | None
    load_noise: Array
    ground_noise: Array
    ground_noise_given: bool
    block: NDArray[np.intp]
    samples: int
    span: float

    def block_sum(self, values: Array | Complex) -> Array:
        """Sum of real values over every block, shape (blocks,)."""
        return np.bincount(self.block, weights=np.real(values), minlength=self.blocks).astype(np.float64)

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return int(self.block[-1]) + 1 if self.block.size else 0

    def keep(self, chosen: NDArray[np.bool_]) -> Spectra:
        """Keep some of the frequencies, with blocks counted anew."""
        _, block = np.unique(self.block[chosen], return_inverse=True)
        return replace(
            self,
            frequency=self.frequency[chosen],
            load=self.load[chosen],
            ground=self.ground[chosen],
            live=None if self.live is None else self.live[chosen],
            load_noise=self.load_noise[chosen],
            ground_noise=self.ground_noise[chosen],
            block=block.astype(np.intp),
        )

    @property
    def coherence(self) -> Array:
        """Squared coherence of load and ground in every block, shape (blocks,)."""
        cross = np.conj(self.ground) * self.load
        square = self.block_sum(cross.real) ** 2 + self.block_sum(cross.imag) ** 2
        power = self.block_sum(np.abs(self.load) ** 2) * self.block_sum(np.abs(self.ground) ** 2)
        return square / power


def transform(recording: Recording, component: str) -> Spectra:
    """Transform the channels of a shaken record.

    Raises
    ------
    FitError
        A channel is missing, constant, or too short.
    """
    load, ground = recording.channel(component), recording.channel(driving_channel("ground", component, recording))
    live_name = other_end(ground.name)
    columns = _columns(recording, load, ground, live_name)
    samples = columns[load.name].size
    frequency = rfftfreq(samples, 1 / recording.rate)
    spectra = {name: rfft(without_line(values)) / np.sqrt(samples) for name, values in columns.items()}
    weight = np.zeros(frequency.size, dtype=np.complex128)
    if "pitch" in columns or "roll" in columns:
        level = np.zeros(samples)
        share = gravity_share(component, pitch=columns.get("pitch", level), roll=columns.get("roll", level))
        weight = STANDARD_GRAVITY * rfft(without_line(share)) / np.sqrt(samples)
    noise = {c.name: c.noise**2 if c.noise else _floor(columns[c.name]) for c in (load, ground)}
    live = None
    if live_name in columns and np.ptp(columns[live_name]) > 0:
        live = _specific_force(recording.channel(live_name), spectra, frequency, weight)
    inside = slice(1, (samples + 1) // 2)
    spectrum = Spectra(
        frequency=frequency[inside],
        load=aligned(load, spectra[component], frequency)[inside],
        ground=_specific_force(ground, spectra, frequency, weight)[inside],
        live=None if live is None else live[inside],
        load_noise=np.full(frequency[inside].size, noise[load.name]),
        ground_noise=(noise[ground.name] / _high_pass(ground, frequency)[1])[inside],
        ground_noise_given=bool(ground.noise),
        block=_blocks(frequency[inside].size),
        samples=samples,
        span=samples / recording.rate,
    )
    return _capped(spectrum, (bool(load.noise), bool(ground.noise)))


def _columns(recording: Recording, load: Channel, ground: Channel, live: str) -> dict[str, Array]:
    """Take the longest usable stretch of the channels that are needed, short gaps bridged."""
    # roll turns no weight along aft, so that its gaps do no harm there
    names = (live, "pitch") if driving_axis(load.name) == "aft" else (live, "pitch", "roll")
    used = [load, ground] + [recording.channel(name) for name in names if name in recording]
    whole = longest_whole(recording, used)
    columns = {channel.name: interpolate_gaps_linearly(channel.values[whole]) for channel in used}
    for channel in (load, ground):
        if np.ptp(columns[channel.name]) == 0:
            raise FitError(
                f"{recording.name}: channel {channel.name} does not change; the ground end must be shaken, "
                "and both its acceleration and the load recorded"
            )
    return columns


def excited(spectra: Spectra, *, band: tuple[float, float] | None, name: str) -> Spectra:
    """Keep the blocks of frequencies in which the load answers the ground motion beyond chance.

    Raises
    ------
    FitError
        There is no such block.
    """
    within = np.ones(spectra.frequency.size, dtype=bool)
    if band is not None:
        within = (spectra.frequency >= band[0]) & (spectra.frequency <= band[1])
        lines = int(np.count_nonzero(within))
        if lines < SETTINGS.least_lines:
            raise FitError(
                f"{name}: {lines or 'no'} frequencies of the record lie in the band {band[0]:g} to {band[1]:g} Hz; "
                f"{SETTINGS.least_lines} are needed: widen the band, or record for longer"
            )
        spectra = spectra.keep(within)
    count = spectra.block_sum(np.ones(spectra.frequency.size))
    # Coherence of n pairs of independent noise exceeds c with probability (1 - c)^(n - 1).
    chance = 1 - (1e-4 / count.size) ** (1 / np.maximum(count - 1, 1))
    chosen = spectra.coherence > np.maximum(SETTINGS.least_coherence, chance)
    for transformed, noise in ((spectra.load, spectra.load_noise), (spectra.ground, spectra.ground_noise)):
        # Quieter than the noise: beyond an anti-alias filter, where nothing is left but what leaks there.
        chosen &= spectra.block_sum(np.abs(transformed) ** 2) > 0.3 * spectra.block_sum(noise)
    if not chosen.any():
        raise FitError(
            f"{name}: the load does not answer the ground acceleration at any frequency (coherence at most "
            f"{np.max(spectra.coherence):.2g}); shake harder or longer, and check that both channels are connected"
        )
    return spectra.keep(chosen[spectra.block])


def _blocks(bins: int) -> NDArray[np.intp]:
    """Number the blocks of neighbouring frequencies: about 512, of at least 32 each."""
    width = max(32, bins // 512)
    return np.minimum(np.arange(bins) // width, max(bins // width - 1, 0)).astype(np.intp)


def _floor(values: Array) -> float:
    """Noise power of a channel: the level that most blocks of its spectrum share.

    The median of exponentially distributed power is ln 2 of its mean, and a few lines in a block do not move it; the
    median of n of them has a relative standard deviation of 1 / (ln 2 sqrt(n)), so blocks of one level lie within
    five of these on either side. A swept sine has a level too, but its power is no exponential: median and mean agree.
    """
    window = np.hanning(values.size)  # without it, motion going on at the ends of the record leaks over the floor
    power = np.abs(rfft(without_line(values) * window)[1:]) ** 2 / np.sum(window**2)
    blocks = np.array_split(power, max(4, min(64, power.size // 64)))
    medians = np.array([float(np.median(block)) / np.log(2) for block in blocks])
    random = medians < SETTINGS.swept * np.array([float(np.mean(block)) for block in blocks])
    levels = np.sort(medians[random] if np.count_nonzero(random) > 1 else medians)
    reach = 1 + 10 / (np.log(2) * np.sqrt(blocks[0].size / SETTINGS.windowed))
    last = np.searchsorted(levels, levels * reach, side="right")
    first = int(np.argmax(last - np.arange(levels.size)))
    return max(float(np.mean(levels[first : last[first]])), 1e-12 * float(np.mean(power)))


def _capped(spectra: Spectra, given: tuple[bool, bool]) -> Spectra:
    """Lower noise floors that are louder than what load and ground have not in common.

    White noise of a channel is at most its incoherent power (1 - coherence) P in every block; a channel that is
    excited up to its highest frequency shows no floor, and this bound is all there is to go by. Blocks quieter than
    the floor (beyond an anti-alias filter) are left out: the noise is not white there.
    """
    count = spectra.block_sum(np.ones(spectra.frequency.size))
    # The least of hundreds of blocks lies about three standard deviations low; the bound allows for four.
    rest = (1 - spectra.coherence) / np.maximum(1 - 4 / np.sqrt(count), 0.3) / count
    levels = []
    for transformed, noise, fixed in zip(
        (spectra.load, spectra.ground), (spectra.load_noise, spectra.ground_noise), given, strict=True
    ):
        power = spectra.block_sum(np.abs(transformed) ** 2)
        bound = float(np.min((rest * power)[power >= spectra.block_sum(noise)], initial=np.inf))
        levels.append(noise if fixed else noise * min(1.0, max(bound, 1e-300) / float(np.min(noise))))
    return replace(spectra, load_noise=levels[0], ground_noise=levels[1])


def aligned(channel: Channel, spectrum: Complex, frequency: Array) -> Complex:
    """Advance the spectrum of a channel by the delay that the channel states."""
    return spectrum * np.exp(2j * np.pi * frequency * channel.delay) if channel.delay else spectrum


def acceleration(channel: Channel, spectrum: Complex, frequency: Array) -> Complex:
    """Spectrum of what an accelerometer feels, from that of its readings: delay and ac coupling are undone."""
    return aligned(channel, spectrum, frequency) / _high_pass(channel, frequency)[0]


def _high_pass(channel: Channel, frequency: Array) -> tuple[Complex, Array]:
    """Response of an ac-coupled sensor and its squared modulus, kept away from zero at zero frequency."""
    if channel.coupling != "ac" or not channel.corner:
        return np.ones(frequency.size, dtype=np.complex128), np.ones(frequency.size)
    safe = np.maximum(frequency, np.min(frequency[frequency > 0]))
    response = 1j * safe / (1j * safe + channel.corner)
    return response, np.abs(response) ** 2


def _specific_force(channel: Channel, spectra: dict[str, Complex], frequency: Array, weight: Complex) -> Complex:
    """Transform of x'' less gravity along the axis, from an accelerometer of any coupling."""
    reading = acceleration(channel, spectra[channel.name], frequency)
    return reading if channel.coupling == "dc" else reading - weight


def longest_whole(recording: Recording, channels: list[Channel]) -> slice:
    """Find the longest stretch without missing or saturated samples, short gaps apart.

    Raises
    ------
    FitError
        The stretch is too short.
    """
    bad = np.zeros(recording.samples, dtype=bool)
    saturated = np.zeros(recording.samples, dtype=bool)
    for channel in channels:
        bad |= channel.missing
        saturated |= channel.saturated
    edges = np.flatnonzero(np.diff(np.concatenate(([0], (bad | saturated).astype(np.int8), [0]))))
    runs = [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
    breaks = [
        (a, b) for a, b in runs if b - a > SETTINGS.longest_bridge or a == 0 or b == bad.size or saturated[a:b].any()
    ]
    starts = [0] + [b for _, b in breaks]
    stops = [a for a, _ in breaks] + [bad.size]
    start, stop = max(zip(starts, stops, strict=True), key=lambda pair: pair[1] - pair[0])
    if stop - start < SETTINGS.least_samples:
        raise FitError(
            f"{recording.name}: {max(stop - start, 0)} samples in a row are usable in all of "
            f"{', '.join(channel.name for channel in channels)}; at least {SETTINGS.least_samples} are needed"
        )
    if runs:
        what = " and ".join(
            f"{np.count_nonzero(flags)} {word}"
            for word, flags in (("missing", bad), ("saturated", saturated))
            if flags.any()
        )
        warn_quality(
            f"{recording.name}: {what} sample(s); {stop - start} of {bad.size} samples in a row are used and gaps of "
            f"up to {SETTINGS.longest_bridge} samples among them are bridged, which makes the uncertainties larger"
        )
    return slice(start, stop)
