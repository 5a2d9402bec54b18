"""What a record is watched for: limits of channels and of loads together, and contact. No clock, no file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance.load_envelope import LoadEnvelope, Station
from aerobalance.io.hdf5_layout import StoredChannel
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import FitError
from aerobalance.recording.units import conversion_for

if TYPE_CHECKING:
    from aerobalance.balance.matrix import BalanceMatrix

Action = Literal["mark", "stop"]


class Guard(Protocol):
    """Says which samples are outside of what is allowed."""

    @property
    def action(self) -> Action:
        """``stop`` ends the record, ``mark`` writes it down."""

    def outside(self, values: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which of the samples, shape (n, c), are outside, and which are known; shape (n,) each."""

    def text(self, values: Array) -> str:
        """Return what one sample, shape (c,), reads and what is allowed."""


@dataclass(frozen=True, slots=True)
class Limit:
    """What a channel must not leave.

    Attributes
    ----------
    column
        Which channel.
    low, high
        Limits in the channel's unit.
    action
        ``stop`` ends the record, ``mark`` writes it down.
    name, unit
        What to call the channel, and its unit.
    """

    column: int
    low: float
    high: float
    action: Action
    name: str
    unit: str = ""

    def outside(self, values: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which samples are outside, and which are known."""
        read = values[:, self.column]
        return (read < self.low) | (read > self.high), ~np.isnan(read)

    def text(self, values: Array) -> str:
        """Return what the channel reads."""
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.name} reads {values[self.column]:.6g}{unit}; allowed: {self.low:g} to {self.high:g}"


@dataclass(frozen=True, slots=True)
class EnvelopeLimit:
    """The loads that the balance may bear together.

    Attributes
    ----------
    envelope
        See `LoadEnvelope`.
    columns
        Columns of its components, in the order of ``envelope.components``.
    factors
        What turns each into SI.
    action
        ``stop`` ends the record, ``mark`` writes it down.
    """

    envelope: LoadEnvelope
    columns: tuple[int, ...]
    factors: tuple[float, ...]
    action: Action

    def outside(self, values: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which samples are outside of the envelope, and which are known."""
        share = self.envelope.utilisation(self._loads(values), self.envelope.components)
        return share > 1, ~np.isnan(share)

    def text(self, values: Array) -> str:
        """Return how much of the envelope is taken up, and by what."""
        found = self.envelope.at_worst(self._loads(values[np.newaxis]), self.envelope.components)
        if found is None:
            return "combined loads are not known"
        return f"combined loads take up {100 * found.share:.4g} % of the load envelope, most by {found.nearest}"

    def _loads(self, values: Array) -> Array:
        return np.asarray(values[:, self.columns] * self.factors)


class ContactCircuit(NamedTuple):
    """The channel that tells of contact between model and support; see `acquisition.fouling.ContactFinder`."""

    column: int
    name: str
    unit: str
    level: float
    closed_above: bool
    hold: int
    action: Action = "mark"


@dataclass(frozen=True, slots=True, eq=False)
class LoadColumns:
    """Loads that are made of the gauge outputs among the channels.

    Attributes
    ----------
    balance
        The matrix.
    columns
        Columns of its gauge outputs.
    factors, zeros
        What turns each into mV/V, and what is then taken off, shape (c,).
    """

    balance: BalanceMatrix
    columns: tuple[int, ...]
    factors: Array
    zeros: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the loads."""
        return loads_of(self.balance)

    def extended(self, values: Array) -> Array:
        """Return the values of all channels, with the loads [N, N*m] in columns after them."""
        outputs = values[:, self.columns] * self.factors - self.zeros
        return np.column_stack((values, felt(self.balance, outputs)))


def loads_of(balance: BalanceMatrix) -> tuple[str, ...]:
    """Names of the loads that a matrix gives: the six components where it is known how to make them."""
    return COMPONENTS if balance.direct is not None else balance.components


def felt(balance: BalanceMatrix, outputs: Array) -> Array:
    """Loads from gauge outputs less their zeros [mV/V], shape (n, c), in the order of `loads_of`."""
    native = balance.loads(np.ascontiguousarray(outputs)).loads
    return native if balance.direct is None else np.asarray(native @ balance.direct.T)


def load_columns(balance: BalanceMatrix, channels: Sequence[StoredChannel]) -> LoadColumns:
    """Find the gauge outputs of a balance among channels.

    A gauge whose channel has no offset has not been zeroed: the natural zero of the balance is taken off, where known.

    Raises
    ------
    FitError
        One is missing, or is not in mV/V.
    """
    places = {channel.name: place for place, channel in enumerate(channels)}
    columns, factors, zeros = [], [], []
    natural = np.zeros(len(balance.gauges)) if balance.natural_zero is None else balance.natural_zero
    for gauge, zero in zip(balance.gauges, natural, strict=True):
        name = f"r{gauge}"
        if name not in places:
            raise FitError(f"the balance needs {name}, which is none of the channels {', '.join(places)}")
        channel = channels[places[name]]
        conversion = conversion_for(name, channel.unit)
        if conversion.unit != "mV/V":
            raise FitError(f"channel {name} is in {conversion.unit}; live loads need it in mV/V, over the excitation")
        columns.append(places[name])
        factors.append(conversion.factor)
        zeros.append(0.0 if channel.offset else float(zero))
    return LoadColumns(balance, tuple(columns), np.array(factors), np.array(zeros))


def capacity_stations(balance: BalanceMatrix) -> tuple[Station, ...]:
    """Return the capacities of a balance's own loads as stations: its combined load diagram.

    Forward and aft gauge of a force balance bear their capacities each, whatever normal force and pitching moment
    these add up to.
    """
    names = loads_of(balance)
    shares = np.eye(len(names)) if balance.direct is None else np.linalg.inv(balance.direct)
    return tuple(
        Station(own, float(capacity), {name: float(share) for name, share in zip(names, row, strict=True) if share})
        for own, capacity, row in zip(balance.components, balance.load_scale, shares, strict=True)
    )


def envelope_limit(
    envelope: LoadEnvelope, columns: Mapping[str, int], *, units: Mapping[str, str], action: Action
) -> EnvelopeLimit:
    """Find the components of an envelope among columns, whose `units` are given."""
    factors = [conversion_for(name, units[name]).factor for name in envelope.components]
    return EnvelopeLimit(envelope, tuple(columns[name] for name in envelope.components), tuple(factors), action)
