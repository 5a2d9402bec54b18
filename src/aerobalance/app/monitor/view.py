"""From the blocks of a source to what the page shows of them. No clock, no file, no process."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.acquisition.continuity import Continuity
from aerobalance.acquisition.fouling import ContactFinder
from aerobalance.acquisition.guards import ContactCircuit, felt, load_columns, loads_of
from aerobalance.acquisition.intake import contact_text
from aerobalance.acquisition.source import Block
from aerobalance.app.monitor.aligned_loads import AlignedLoads
from aerobalance.app.monitor.health import health_of, is_still, verdict_on
from aerobalance.app.monitor.messages import LINES, ShownForce, ShownReading, Update
from aerobalance.app.monitor.minmax_strips import Extremes
from aerobalance.app.monitor.running_spectrum import RunningSpectrum
from aerobalance.app.monitor.steady import newest_steady
from aerobalance.balance.load_envelope import LoadEnvelope
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.weight_on_zero import gauge_zero_of_readings
from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.estimation.live.health import LiveEstimate
from aerobalance.estimation.live.live_force import LiveForce
from aerobalance.estimation.live.platform import LiveChannel
from aerobalance.estimation.live.settings import LiveSettings
from aerobalance.io.hdf5_layout import StoredChannel
from aerobalance.io.measure import LARGEST
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY, is_gauge, si_unit
from aerobalance.recording.units import Conversion, conversion_for

FINEST: Final = 1e-3
"""Length of the shortest bin of a chart [s]."""

NUMBERS: Final = 0.2
"""Time that the numbers are drawn up over [s]."""

SPECTRA: Final = 0.5
"""Time between spectra [s]."""

WARNING: Final = 0.8
"""Part of a limit from which on a load is shown as high."""


@dataclass(frozen=True, slots=True)
class Panel:
    """What is watched.

    Attributes
    ----------
    channels
        The c channels of the source.
    rate
        Sampling rate [Hz].
    clocked
        Whether the source's clock is steady.
    dynamics
        Dynamics of the components whose force is wanted.
    half_ranges
        Half of the range of components, SI.
    limits
        Limits of channels, SI.
    zeros
        What is taken off the loads and gauge outputs, SI.
    balance
        The matrix that makes loads of gauge outputs; None where the channels are loads.
    envelope
        The loads that may act together; None where none is set up.
    circuit
        The contact circuit between model and support; None where there is none.
    gravity
        Local acceleration of gravity [m/s^2].
    """

    channels: tuple[StoredChannel, ...]
    rate: float
    clocked: bool
    dynamics: BalanceDynamics
    half_ranges: Mapping[str, float]
    limits: Mapping[str, tuple[float, float]]
    zeros: Mapping[str, float] = field(default_factory=dict)
    balance: BalanceMatrix | None = None
    envelope: LoadEnvelope | None = None
    circuit: ContactCircuit | None = None
    gravity: float = STANDARD_GRAVITY

    @property
    def width(self) -> int:
        """Ticks of the shortest bin."""
        return max(1, int(FINEST * self.rate))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the channels, and of the loads that are made of them after these."""
        given = tuple(channel.name for channel in self.channels)
        return (*given, *self.loads)

    @property
    def loads(self) -> tuple[str, ...]:
        """Loads that are made of gauge outputs."""
        return () if self.balance is None else loads_of(self.balance)

    @property
    def delays(self) -> tuple[float, ...]:
        """Times by which the channels and the loads lag the clock [s]; a load lags as its gauges do on average."""
        gauges = [channel.delay for channel in self.channels if is_gauge(channel.name)]
        made = float(np.mean(gauges)) if gauges else 0.0
        return (*(channel.delay for channel in self.channels), *(made for _ in self.loads))

    @property
    def units(self) -> tuple[str, ...]:
        """Units in which the channels are shown."""
        return (*(_conversion(channel).unit for channel in self.channels), *(si_unit(name) for name in self.loads))

    @property
    def components(self) -> tuple[str, ...]:
        """Components whose force is worked out."""
        known = self.dynamics.estimable(self.names)
        return tuple(name for name in COMPONENTS if name in known)

    @property
    def masses(self) -> Mapping[str, float]:
        """Moving mass of components of which it is known along one axis only [kg, kg*m^2]."""
        alone = [block for block in self.dynamics.blocks if np.count_nonzero(block.moved_by) == 1]
        return {block.components[0]: float(block.mass_rows.sum()) for block in alone}

    @property
    def frequencies(self) -> Mapping[str, float]:
        """Natural frequency that each component has alone [Hz]."""
        own = np.sqrt(np.diag(self.dynamics.quadratic[1]))
        return dict(zip(self.dynamics.components, (1 / (2 * np.pi * own)).tolist(), strict=True))


class View:
    """Watches a source.

    Parameters
    ----------
    panel
        What is watched.
    """

    def __init__(self, panel: Panel) -> None:
        self.panel = panel
        names = panel.names
        self._conversions = [_conversion(channel) for channel in panel.channels]
        self._gauges = None if panel.balance is None else load_columns(panel.balance, panel.channels)
        circuit = panel.circuit
        self._contact = circuit and ContactFinder(circuit.level, hold=circuit.hold, closed_above=circuit.closed_above)
        self._continuity = Continuity(panel.rate, clocked=panel.clocked)
        self._streams = _followed(panel)
        self._aligned = None
        if self._gauges is not None:
            late = [panel.rate * (delay - panel.delays[-1]) for delay in panel.delays]
            self._aligned = AlignedLoads(self._gauges, loads=len(panel.channels), late=late)
        self.lines = {name: live for live, _ in self._streams for name in live.components}
        width = max([panel.width, *(line.factor for line in self.lines.values())])
        self.width = width
        self._raw = Extremes(len(names), width)
        self._force = {name: Extremes(2, width, step=line.factor) for name, line in self.lines.items()}
        self._spectra = {name: RunningSpectrum(2, line.interval) for name, line in self.lines.items()}
        self._offsets = np.zeros(len(names))
        self._large = np.zeros(len(names), dtype=np.intp)
        self._quiet = 0
        self._means: list[tuple[float, Array]] = []
        self._held_since = 0.0
        self._held: list[Array] = []
        self._held_rows = 0
        self._estimates: dict[str, list[Array]] = {}
        self.set_zeros(panel.zeros)
        self._since_spectra = 0
        self._saturated = dict.fromkeys(names, 0)
        self.update = Update(0, 0.0)

    def set_zeros(self, zeros: Mapping[str, float]) -> None:
        """Take off other zeros from now on; the numbers to come are of samples from now on alone."""
        given = dict(zeros)
        if self._gauges is not None:
            own = zip(self._gauges.balance.gauges, self._gauges.zeros.tolist(), strict=True)
            given = {f"r{gauge}": zero for gauge, zero in own} | given
        self._offsets[:] = [given.get(name, 0.0) for name in self.panel.names]
        self._means, self._held, self._held_rows = [], [], 0
        self._estimates = {name: [] for name in self.lines}
        if self._aligned is not None:
            self._aligned.forget()
        for live, _ in self._streams:
            live.restart()

    def zeros(self) -> dict[str, float]:
        """Return the zeros that make the loads of the last second read the weight alone.

        A load or gauge output without readings in that second keeps the zero that it has.

        Raises
        ------
        ValueError
            There are no readings yet, or none of a channel that makes the loads or the weight.
        """
        means = _means(self.means)
        weights = _weights(self.panel, means)
        self._check_readings(means, weights)
        found = {}
        for place, name in enumerate(self.panel.names):
            if name not in self.panel.loads and (name in COMPONENTS or is_gauge(name)):
                if np.isfinite(means[place]):
                    found[name] = float(means[place] + self._offsets[place] - weights.get(name, 0.0))
                elif self._offsets[place]:
                    found[name] = float(self._offsets[place])
        return found | self._zeros_of_gauges(found, weights)

    def _check_readings(self, means: Array, weights: Mapping[str, float]) -> None:
        """Refuse to take a zero of the last second where nothing was read, or not what the other zeros are made of."""
        lacking = [name for name, mean in zip(self.panel.names, means, strict=True) if not np.isfinite(mean)]
        if len(lacking) == len(self.panel.names):
            raise ValueError("there are no readings yet to take the zero from")
        needed = set() if self._gauges is None else {f"r{gauge}" for gauge in self._gauges.balance.gauges}
        if not all(map(math.isfinite, weights.values())):
            needed |= {"pitch", "roll"}
        lacking = [name for name in lacking if name in needed]
        if lacking:
            raise ValueError(
                f"no zero is taken: there are no readings of {', '.join(lacking)} in the last second, without which "
                f"{'the weight' if {*lacking} <= {'pitch', 'roll'} else 'the loads'} cannot be told"
            )

    def _zeros_of_gauges(self, read: Mapping[str, float], weights: Mapping[str, float]) -> dict[str, float]:
        """Zeros of the gauges less what they read by the weight, and those of the loads that are made of them.

        Curved bridges are read from where the weight has brought them: known along components whose force is worked
        out, and along the others by the distance from the natural zeros. The latter load counts from there.
        """
        gauges, loads = self._gauges, self.panel.loads
        if gauges is None:
            return {}
        balance = gauges.balance
        if balance.natural_zero is not None:  # readings with an offset in the set-up count from that zero
            balance = replace(balance, natural_zero=gauges.zeros)
        known = {name: value if name in loads else 0.0 for name, value in weights.items()}
        under, beyond = gauge_zero_of_readings(read, balance, weight=known, source="the last second")
        given = {f"r{gauge}": value for gauge, value in zip(balance.gauges, under.values.tolist(), strict=True)}
        return given | dict(zip(loads, beyond.tolist(), strict=True))

    @property
    def means(self) -> Array:
        """Means of the channels over the last spans of `NUMBERS` that are complete, up to five: shape (m, c), SI."""
        return np.array([means for _, means in self._means]).reshape(-1, len(self.panel.names))

    @property
    def means_since(self) -> float:
        """When the first sample of `means` came, on the steady clock [s]."""
        return self._means[0][0] if self._means else -math.inf

    def feed(self, block: Block) -> None:
        """Take a block; what is new is added to `update`."""
        watched = self._continuity.follow(block)
        update = self.update
        if watched.gap is not None:
            update.lost += watched.gap.samples
            text = f"{watched.gap.samples} samples of each channel: {watched.gap.text}"
            update.remarks.append((watched.gap.tick, watched.gap.kind, text))
        update.remarks += [(event.tick, event.kind, event.text) for event in watched.events]
        if watched.block is None:
            return
        tick, values = watched.block.tick, self._values(watched.block.samples)
        self._tell_large(tick)
        update.tick, update.received = watched.block.end, block.received
        self._watch_contact(tick, values)
        if self._aligned is not None:
            tick, values = self._aligned.push(tick, values, offsets=self._offsets)
            self._without_large(values)
        if not len(values):
            return
        update.raw.append(self._raw.push(tick, values))
        for name, piece in self._final(tick, values):
            pair = np.column_stack((piece.force, piece.uncertainty))
            update.forces.setdefault(name, []).append(self._force[name].push(piece.first, pair))
            self._estimates[name].append(pair)
            self._spectra[name].push(np.column_stack((piece.load, piece.force)))
        self._count(values, block.received - (update.tick - tick - len(values)) / self.panel.rate)

    def _final(self, tick: int, values: Array) -> list[tuple[str, LiveEstimate]]:
        """Samples of the forces that have become final by readings of all channels, SI."""
        found = [live.push(values[:, columns], first=tick) for live, columns in self._streams]
        return [(name, piece) for forces in found for name, piece in forces.items() if piece.force.size]

    def take(self) -> Update:
        """Return what is new since the last call."""
        update = self.update
        self.update = Update(update.tick, update.received, lost=update.lost)
        return update

    def _values(self, samples: Array) -> Array:
        pairs = zip(self.panel.channels, self._conversions, strict=True)
        values = np.zeros((samples.shape[0], len(self.panel.names)))
        with np.errstate(over="ignore", invalid="ignore"):  # of numbers that count as missing
            for place, (channel, conversion) in enumerate(pairs):
                values[:, place] = conversion.inside(channel.values(samples[:, place]))
            self._large += self._without_large(values)
            values -= self._offsets
            if self._gauges is not None:
                outputs = values[:, self._gauges.columns]
                values[:, samples.shape[1] :] += felt(self._gauges.balance, outputs)
                self._without_large(values)
        return values

    def _without_large(self, values: Array) -> NDArray[np.intp]:
        """Make numbers missing that no reading is; return how many there were in each column."""
        large = np.abs(values) > LARGEST
        if large.any():
            values[large] = np.nan
        return np.asarray(large.sum(axis=0))

    def _tell_large(self, tick: int) -> None:
        """Say, once a second, how many readings were beyond all measure."""
        if not self._large.any() or tick < self._quiet:
            return
        self._quiet = tick + round(self.panel.rate)
        some = [f"{count} of {name}" for name, count in zip(self.panel.names, self._large, strict=True) if count]
        text = f"beyond {LARGEST:.0e} either way, which no reading is; they count as missing: {', '.join(some)}"
        self.update.remarks.append((tick, "too large", text))
        self._large[:] = 0

    def _watch_contact(self, tick: int, values: Array) -> None:
        circuit, finder = self.panel.circuit, self._contact
        if circuit is None or finder is None:
            return
        for contact in finder.push(tick, values[:, circuit.column]):
            kind = "contact" if contact.closed else "contact over"
            self.update.remarks.append((contact.tick, kind, contact_text(contact, circuit, self.panel.rate)))
        self.update.touching = finder.touching

    def _count(self, values: Array, received: float) -> None:
        """Draw up numbers and spectra where they are due; the last of the values came at a time [s]."""
        if not self._held:
            self._held_since = received - (values.shape[0] - 1) / self.panel.rate
        self._held.append(values)
        self._held_rows += values.shape[0]
        if self._held_rows < NUMBERS * self.panel.rate:
            return
        held = np.concatenate(self._held)
        self._held, self._held_rows = [], 0
        for place, name in enumerate(self.panel.names):
            self.update.readings[name] = self._reading(name, held[:, place])
        envelope = self.panel.envelope
        if envelope is not None:
            self.update.envelope = envelope.at_worst(held, self.panel.names)
        self._means = [*self._means[-4:], (self._held_since, _means(held))]
        for name, line in self.lines.items():
            parts, self._estimates[name] = self._estimates[name], []
            if parts:
                self.update.estimates[name] = _estimate(np.concatenate(parts), line.interval)
            still = is_still(held[:, self.panel.names.index(name)])
            self.update.health[name] = health_of(line, name) | verdict_on(line, name, parts, still=still)
        self._since_spectra += 1
        if self._since_spectra * NUMBERS >= SPECTRA:
            self._since_spectra = 0
            self._draw_spectra()

    def _reading(self, name: str, values: Array) -> ShownReading:
        known = values[np.isfinite(values)]
        if not known.size:
            return ShownReading(math.nan, math.nan, math.nan, None, None, "none")
        self._saturated[name] += int(Channel("reading", known, "1").saturated.sum()) if known.size > 8 else 0
        least, largest = float(known.min()), float(known.max())
        mean, samples, step = newest_steady(known) if name in COMPONENTS else (float(known.mean()), known.size, 0.0)
        half = self.panel.half_ranges.get(name)
        low, high = self.panel.limits.get(name, (-half, half) if half else (-math.inf, math.inf))
        percent = None if half is None else 100 * max(-least, largest) / half
        shares = [largest / high if high > 0 else math.inf if largest > high else 0.0]
        shares.append(least / low if low < 0 else math.inf if least < low else 0.0)
        share = max(0.0, *shares)
        state = "over" if share >= 1 else "high" if share >= WARNING else "ok"
        limit = share if math.isfinite(low) or math.isfinite(high) else None
        return ShownReading(mean, least, largest, percent, limit, state, samples / self.panel.rate, step)

    @property
    def saturated(self) -> Mapping[str, int]:
        """Readings that rested on the end of their range, by channel."""
        return self._saturated

    def _draw_spectra(self) -> None:
        for name, spectrum in self._spectra.items():
            if spectrum.ready:
                lines = spectrum.amplitudes()
                shown = lines.reshape(LINES, -1, 2).max(axis=1).astype(np.float32)
                self.update.spectra[name] = (float(spectrum.frequency[-1]), shown)


def _estimate(pair: Array, interval: float) -> ShownForce:
    """Draw up force and standard uncertainty, shape (n, 2), over the time of `NUMBERS`."""
    known = pair[np.isfinite(pair).all(axis=1)]
    if not len(known):
        return ShownForce(math.nan, math.nan, math.nan, math.nan, 0.0, 0.0)
    force, uncertainty = known[:, 0], float(known[:, 1].mean())
    mean, samples, step = newest_steady(force, uncertainty=uncertainty)
    return ShownForce(mean, uncertainty, float(force.min()), float(force.max()), samples * interval, step)


def _means(values: Array) -> Array:
    """Mean of what is known of each channel; NaN where nothing is."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.where(known, values, 0.0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _conversion(channel: StoredChannel) -> Conversion:
    return conversion_for(channel.name, channel.unit)


def _followed(panel: Panel) -> list[tuple[LiveForce, list[int]]]:
    """The live forces, and the columns that each takes."""
    known = set(panel.components)
    return [_live(panel, block) for block in panel.dynamics.blocks if known.issuperset(block.components)]


def _live(panel: Panel, dynamics: BalanceDynamics) -> tuple[LiveForce, list[int]]:
    own, moves = dynamics.components, bool(dynamics.moved_by.any())
    columns = [place for place, name in enumerate(panel.names) if name in own or (moves and name not in COMPONENTS)]
    sensors = dict(enumerate(panel.channels))
    channels = []
    for place in columns:
        name, delay = panel.names[place], panel.delays[place]
        known = sensors.get(place)
        if known is None:
            channels.append(LiveChannel(name, delay=delay))
        else:
            mounted = LiveChannel(name, delay=delay, coupling=known.coupling, axis=known.axis, place=known.place)
            channels.append(mounted)
    settings = LiveSettings(learn_inside=False)
    live = LiveForce(dynamics, rate=panel.rate, channels=channels, gravity=panel.gravity, settings=settings)
    return live, columns


def _weights(panel: Panel, means: Array) -> dict[str, float]:
    """Weight along the components at mean readings of all channels, shape (c,): a zero must not take it off."""
    places = {name: place for place, name in enumerate(panel.names)}
    if "pitch" not in places:
        return dict.fromkeys(panel.components, 0.0)
    pitch, roll = (means[[places[name]]] if name in places else np.zeros(1) for name in ("pitch", "roll"))
    weight = partial(panel.dynamics.weight, pitch=pitch, roll=roll, gravity=panel.gravity)
    return {name: float(weight(name)[0]) for name in panel.components}
