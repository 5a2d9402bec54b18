"""Stepped-sine records: where each frequency is held, what amplitudes it gives, and how steady it is."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.special import chdtrc

from aerobalance.dynamics.single import Dynamics
from aerobalance.identification.base_excitation.spectra import Complex, acceleration, aligned
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import driving_channel, other_end
from aerobalance.recording.errors import FitError
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import corrected


@dataclass(frozen=True, slots=True)
class DwellSettings:
    """Thresholds of the search for dwells of a stepped sine.

    Attributes
    ----------
    windows
        Lengths of the sliding window that are tried in the search for held frequencies [s].
    parts
        Parts of a dwell whose amplitudes are compared to judge its steadiness.
    settled
        Shares of a dwell that are tried, the least first, as the time to settle.
    drift_allowed
        Relative scatter of the amplitude within a dwell that is called steady even where the noise is less.
    """

    windows: tuple[float, ...] = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
    parts: int = 8
    settled: tuple[float, ...] = (0.1, 0.2, 0.3, 0.4, 0.5)
    drift_allowed: float = 0.003


SETTINGS: Final = DwellSettings()
"""Thresholds that are used."""


@dataclass(frozen=True, slots=True)
class Dwell:
    """One frequency held for a while; complex amplitudes X stand for Re(X exp(i w t)), t from the recording's time 0.

    Filters, cross-axis sensitivities, delays and ac coupling that the channels state are undone in the amplitudes.

    Attributes
    ----------
    start, stop
        First sample used, after settling, and the one past the last.
    frequency, u_frequency
        Frequency fitted and its standard uncertainty [Hz].
    load, u_load
        Complex amplitude of the load and the standard uncertainty of its modulus [N; N*m].
    ground, u_ground
        The same of the ground acceleration [m/s^2].
    live, u_live
        The same of the live acceleration [m/s^2]; NaN where it was not recorded.
    drift
        Scatter of load and ground acceleration within the dwell beyond their noise, relative [1], the larger one.
    steady
        Whether neither amplitude nor phase drifts beyond noise.
    """

    start: int
    stop: int
    frequency: float
    u_frequency: float
    load: complex
    u_load: float
    ground: complex
    u_ground: float
    live: complex
    u_live: float
    drift: float
    steady: bool


@dataclass(frozen=True, slots=True)
class HarmonicDeviation:
    """Measured load amplitude against Eq. (12) at one dwell, and what makes the difference.

    Attributes
    ----------
    frequency
        Frequency of the dwell [Hz].
    measured, calculated
        Amplitude of the load as measured, and as calculated from the ground acceleration for steady motion [N; N*m].
    unsteadiness
        Part of measured - calculated that the motion's not being steady explains: the full dynamics driven by the
        measured ground acceleration, fitted in the same way, less the steady formula [N; N*m].
    model
        The rest: measured less full dynamics [N; N*m]; it contains the noise.
    accelerometer_noise
        Standard deviation of `calculated` from the noise of the accelerometer [N; N*m].
    balance_noise
        Standard deviation of `measured` from the noise of the balance [N; N*m].
    steady
        Whether the dwell is steady.
    """

    frequency: float
    measured: float
    calculated: float
    unsteadiness: float
    model: float
    accelerometer_noise: float
    balance_noise: float
    steady: bool

    @property
    def deviation(self) -> float:
        """Measured less calculated amplitude [N; N*m]."""
        return self.measured - self.calculated


def find_dwells(recording: Recording, *, component: str = "AF") -> tuple[Dwell, ...]:
    """Find the dwells of a stepped-sine record and fit each.

    Parameters
    ----------
    recording
        Recording with the load, the acceleration of the ground end along it (`ground_acceleration_z` for NF, `_y` for
        SF; else `ground_acceleration`) and, optionally, that of the live end of the same ending.
    component
        The load channel.

    Returns
    -------
    tuple of Dwell
        In the order of time.

    Raises
    ------
    FitError
        The record holds no frequency long enough.
    """
    recording = corrected(recording)
    ground = driving_channel("ground", component, recording)
    live = other_end(ground)
    channels = [recording.channel(name) for name in (component, ground, *([live] if live in recording else []))]
    for channel in channels:
        if not np.isfinite(channel.values).all():
            raise FitError(
                f"{recording.name}: channel {channel.name} has missing samples; dwells need a record without gaps"
            )
        if channel.name != live and np.ptp(channel.values) == 0:
            raise FitError(f"{recording.name}: channel {channel.name} does not change; the ground end must be shaken")
    stretches = _steady_stretches(channels[0].values, recording.rate)
    dwells = [_fit_dwell(channels, stretch=stretch, rate=recording.rate) for stretch in stretches]
    found = tuple(dwell for dwell in dwells if dwell is not None)
    if not any(dwell.steady for dwell in found):
        raise FitError(
            f"{recording.name}: no frequency is held steadily for eight of its periods or more; this is no "
            "stepped sine (a sweep or noise is identified as it is)"
        )
    return found


def harmonic_check(
    recording: Recording, dwells: tuple[Dwell, ...], *, dynamics: Dynamics
) -> tuple[HarmonicDeviation, ...]:
    """Compare the load amplitude of every dwell with Eq. (12) and split the difference.

    Parameters
    ----------
    recording
        The record the dwells were found in.
    dwells
        The dwells.
    dynamics
        Mass, stiffness and damping to calculate with.
    """
    full = _driven(corrected(recording), dynamics)
    checks = []
    for dwell in dwells:
        calculated = float(dynamics.amplitude(dwell.frequency, abs(dwell.ground)))
        gain = float(dynamics.amplitude(dwell.frequency, 1.0))
        window = slice(dwell.start, dwell.stop)
        amplitude, _ = _sine(full[window], dwell.frequency, start=dwell.start, rate=recording.rate)
        checks.append(
            HarmonicDeviation(
                frequency=dwell.frequency,
                measured=abs(dwell.load),
                calculated=calculated,
                unsteadiness=abs(amplitude) - calculated,
                model=abs(dwell.load) - abs(amplitude),
                accelerometer_noise=gain * dwell.u_ground,
                balance_noise=dwell.u_load,
                steady=dwell.steady,
            )
        )
    return tuple(checks)


def _driven(recording: Recording, dynamics: Dynamics) -> Array:
    """Load that the full dynamics give for the measured ground acceleration, from rest, shape (n,)."""
    channel = recording.channel(driving_channel("ground", dynamics.component, recording))
    ground = channel.values
    memory = int(recording.rate * min(20 / max(dynamics.decay_rate, 1e-9), recording.duration))
    length = next_fast_len(ground.size + memory, real=True)
    frequency = rfftfreq(length, 1 / recording.rate)
    felt = acceleration(channel, rfft(ground - ground.mean(), length), frequency)
    return irfft(dynamics.base_response(frequency) * felt, length)[: ground.size]


def _steady_stretches(values: Array, rate: float) -> list[tuple[int, int, float]]:
    """Find the stretches of one frequency: first sample, one past the last, frequency [Hz].

    The window that leaves least of the signal unexplained by its stretches is taken.
    """
    best: tuple[float, list[tuple[int, int, float]]] = (np.inf, [])
    centred = values - values.mean()
    total = float(np.sum(centred**2))
    for length in SETTINGS.windows:
        width = round(length * rate)
        if width < 16 or 4 * width > values.size:
            continue
        stretches = _stretches(centred, width=width, rate=rate)
        explained = sum(
            0.5 * (stop - start) * abs(_sine(centred[start:stop], f, start=start, rate=rate)[0]) ** 2
            for start, stop, f in stretches
        )
        # A window shorter by far explains as much with stretches cut in two: each stretch has to earn its place.
        unexplained = (total - explained) / total + 1e-3 * len(stretches) / max(1.0, len(best[1]) or len(stretches))
        if unexplained < best[0] - 1e-3:
            best = (unexplained, stretches)
    return best[1]


def _stretches(values: Array, *, width: int, rate: float) -> list[tuple[int, int, float]]:
    """Stretches of constant frequency as a sliding window of the given width sees them."""
    hop = max(width // 4, 1)
    ridge, power = _ridge(values, width=width, hop=hop, rate=rate)
    tolerance = _tolerance(ridge, resolution=rate / width)
    loud = power > 1e-4 * np.max(power)
    # A window that straddles a step sees both frequencies; a run of three that agree lies on one side of it.
    same = np.abs(np.diff(ridge)) < tolerance[1:]
    same &= loud[1:] & loud[:-1]
    edges = np.flatnonzero(np.diff(np.concatenate(([0], same.astype(np.int8), [0]))))
    runs = [(int(a), int(b)) for a, b in edges.reshape(-1, 2) if b - a >= 2]
    groups: list[list[tuple[int, int]]] = []
    for run in runs:
        if groups and _alike(ridge, groups[-1][-1], run, tolerance):
            groups[-1].append(run)
        else:
            groups.append([run])
    spans = [(group[0][0], group[-1][1], float(np.median(ridge[group[0][0] : group[-1][1] + 1]))) for group in groups]
    spans = _filled(spans, ridge, loud)
    if not spans:
        return []
    bounds = [0.5 * (a[1] + b[0]) for a, b in itertools.pairwise(spans)]
    starts = [max(0.0, spans[0][0] - 0.5), *bounds]
    stops = [*bounds, spans[-1][1] + 0.5]
    centre = width / 2
    return [
        (max(0, round(a * hop + centre)) if i else 0, min(values.size, round(b * hop + centre)), f)
        for i, ((a, b), (_, _, f)) in enumerate(zip(zip(starts, stops, strict=True), spans, strict=True))
        if (b - a) * hop * f / rate >= 8
    ]


def _tolerance(ridge: Array, *, resolution: float) -> Array:
    """Step of the ridge from one position to the next that noise explains, shape (hops,) [Hz].

    Most neighbours lie in one dwell, so the median step nearby measures the noise, whose standard deviation it is
    1.48 times over.
    """
    steps = np.abs(np.diff(ridge, prepend=ridge[0]))
    reach = min(31, steps.size - 1 + steps.size % 2)
    usual = np.median(
        np.lib.stride_tricks.sliding_window_view(np.pad(steps, reach // 2, mode="reflect"), reach), axis=1
    )
    return np.asarray(np.clip(6 * 1.48 * usual[: ridge.size], 0.01 * resolution, 0.3 * resolution))


def _alike(ridge: Array, first: tuple[int, int], second: tuple[int, int], tolerance: Array) -> bool:
    """Whether two neighbouring runs are one frequency with a disturbance in between."""
    f1, f2 = (float(np.median(ridge[a : b + 1])) for a, b in (first, second))
    between = ridge[first[1] : second[0] + 1]
    return abs(f1 - f2) < tolerance[second[0]] and bool(np.all(np.abs(between - f1) < 0.05 * f1))


def _filled(
    spans: list[tuple[int, int, float]], ridge: Array, loud: NDArray[np.bool_]
) -> list[tuple[int, int, float]]:
    """Add the stretches between the dwells that are as long as dwells but not steady enough to be seen as such."""
    if not spans:
        return spans
    typical = float(np.median([b - a for a, b, _ in spans]))
    result = list(spans)
    ends = [(0, spans[0][0])] + [(a[1], b[0]) for a, b in itertools.pairwise(spans)] + [(spans[-1][1], ridge.size - 1)]
    for a, b in ends:
        if b - a > 0.6 * typical + 4 and loud[a + 2 : b - 1].mean() > 0.8:
            result.append((a + 2, b - 2, float(np.median(ridge[a + 2 : b - 1]))))
    return sorted(result)


def _ridge(values: Array, *, width: int, hop: int, rate: float) -> tuple[Array, Array]:
    """Loudest frequency [Hz] and its power in every position of a sliding Hann window."""
    frames = np.lib.stride_tricks.sliding_window_view(values, width)[::hop]
    taper = np.hanning(width)
    length = next_fast_len(2 * width, real=True)
    frequency, power = np.empty(len(frames)), np.empty(len(frames))
    for first in range(0, len(frames), 256):
        spectrum = np.abs(rfft(frames[first : first + 256] * taper, length, axis=1))
        peak = np.clip(np.argmax(spectrum, axis=1), 1, spectrum.shape[1] - 2)
        rows = np.arange(len(peak))
        left, middle, right = (np.log(spectrum[rows, peak + shift] + 1e-300) for shift in (-1, 0, 1))
        curve = left - 2 * middle + right
        offset = np.where(curve < 0, 0.5 * (left - right) / np.where(curve < 0, curve, -1.0), 0.0)
        block = slice(first, first + len(peak))
        frequency[block] = (peak + np.clip(offset, -0.5, 0.5)) * rate / length
        power[block] = spectrum[rows, peak] ** 2
    return frequency, power


def _sine(values: Array, frequency: float, *, start: int, rate: float) -> tuple[complex, float]:
    """Fit offset, slope and a sine of known frequency: complex amplitude, and standard deviation of the residual."""
    index = np.arange(values.size)
    phase = 2 * np.pi * frequency * (index + start) / rate
    ramp = index / max(values.size - 1, 1) - 0.5
    basis = np.array([np.cos(phase), -np.sin(phase), np.ones(values.size), ramp])
    # some periods, of which these four are all but orthogonal: their normal equations lose nothing
    solution = np.linalg.solve(basis @ basis.T, basis @ values)
    residual = values - solution @ basis
    return complex(solution[0], solution[1]), float(np.sqrt(residual @ residual / max(values.size - 4, 1)))


def _refined(values: Array, frequency: float, *, start: int, rate: float) -> tuple[float, float]:
    """Fit the frequency of a sine: value and standard uncertainty [Hz]."""
    index = np.arange(values.size)
    time = (index - 0.5 * (values.size - 1)) / rate
    uncertainty = np.inf
    for _ in range(12):
        amplitude, deviation = _sine(values, frequency, start=start, rate=rate)
        phase = 2 * np.pi * frequency * (index + start) / rate
        wave = amplitude * np.exp(1j * phase)
        basis = np.array([np.cos(phase), -np.sin(phase), np.ones(values.size), -2 * np.pi * time * wave.imag])
        normal = basis @ basis.T
        step = float(np.linalg.solve(normal, basis @ (values - wave.real))[3])
        step = float(np.clip(step, -0.25 * rate / values.size, 0.25 * rate / values.size))
        frequency += step
        uncertainty = deviation * float(np.sqrt(np.linalg.inv(normal)[3, 3]))
        if abs(step) < 1e-3 * uncertainty + 1e-12 * frequency:
            break
    return frequency, uncertainty


def _fit_dwell(channels: list[Channel], *, stretch: tuple[int, int, float], rate: float) -> Dwell | None:
    """Fit one dwell from the first time on at which it is steady, or from half of it on if it never is.

    The channels are the load, the ground's acceleration and, where it is recorded, the live end's.
    """
    first, stop, guess = stretch
    stop -= max(1, round(0.02 * (stop - first)))
    attempts = []
    for share in SETTINGS.settled:
        start = first + round(share * (stop - first))
        if (stop - start) * guess / rate < 8 or stop - start < 64:
            break
        attempts.append(_fit_part(channels, part=(start, stop, guess), rate=rate))
        if attempts[-1].steady:
            break
    return attempts[-1] if attempts else None


def _fit_part(channels: list[Channel], *, part: tuple[int, int, float], rate: float) -> Dwell:
    """Fit frequency and complex amplitudes of one stretch and judge its steadiness."""
    start, stop, guess = part
    window = slice(start, stop)
    frequency, u_frequency = _refined(channels[0].values[window], guess, start=start, rate=rate)
    fitted: list[tuple[complex, float]] = []
    drift, steady = 0.0, True
    for place, channel in enumerate(channels):
        values = channel.values[window]
        amplitude, deviation = _sine(values, frequency, start=start, rate=rate)
        scatter, beyond, noise = _drift(values, frequency, start=start, rate=rate)
        u = max(noise, 0.0) * float(np.sqrt(2 / (stop - start))) if noise > 0 else deviation
        undo = acceleration if place else aligned
        factor = complex(undo(channel, np.ones(1, dtype=np.complex128), np.array([frequency]))[0])
        fitted.append((amplitude * factor, u * abs(factor)))
        if place < 2:  # the live end's is a check
            drift = max(drift, scatter)
            steady &= not beyond
    (load, u_load), (ground, u_ground), (live, u_live) = (*fitted, (complex("nan"), float("nan")))[:3]
    return Dwell(
        start=start,
        stop=stop,
        frequency=frequency,
        u_frequency=u_frequency,
        load=load,
        u_load=u_load,
        ground=ground,
        u_ground=u_ground,
        live=live,
        u_live=u_live,
        drift=drift,
        steady=steady,
    )


def _drift(values: Array, frequency: float, *, start: int, rate: float) -> tuple[float, bool, float]:
    """Scatter of amplitude and phase over the parts of a dwell: relative, whether beyond noise, and the noise."""
    periods = values.size * frequency / rate
    parts = int(min(SETTINGS.parts, max(2, periods // 3)))
    fits = [
        _sine(values[block], frequency, start=start + int(block[0]), rate=rate)
        for block in np.array_split(np.arange(values.size), parts)
    ]
    amplitudes: Complex = np.array([fit[0] for fit in fits])
    noise = float(np.sqrt(np.mean([fit[1] ** 2 for fit in fits])))
    mean = complex(amplitudes.mean())
    variance = 2 * noise**2 / (values.size / parts)
    square = float(np.sum(np.abs(amplitudes - mean) ** 2))
    excess = max(square / (parts - 1) - 2 * variance, 0.0)
    relative = float(np.sqrt(excess) / max(abs(mean), 1e-300))
    chance = float(chdtrc(2 * (parts - 1), square / max(variance, 1e-300)))
    return relative, bool(chance < 1e-4 and relative > SETTINGS.drift_allowed), noise


def amplitudes(dwells: tuple[Dwell, ...]) -> tuple[Array, Complex, Complex, Complex]:
    """Frequencies [Hz] and complex amplitudes of load, ground and live acceleration of dwells, shape (n,) each."""
    return (
        np.array([dwell.frequency for dwell in dwells]),
        np.array([dwell.load for dwell in dwells], dtype=np.complex128),
        np.array([dwell.ground for dwell in dwells], dtype=np.complex128),
        np.array([dwell.live for dwell in dwells], dtype=np.complex128),
    )
