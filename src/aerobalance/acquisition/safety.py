"""Tables of a set-up that say what the balance may bear, and how it is checked."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from aerobalance.acquisition.fouling import HOLD
from aerobalance.acquisition.pretest_checks import RETURN_TOLERANCE, SHUNT_TOLERANCE, shunt_output
from aerobalance.acquisition.source_settings import Above, Name, SetupTable
from aerobalance.balance.load_envelope import Station
from aerobalance.io.channel_settings import NotBelow, Number
from aerobalance.recording.components import COMPONENTS

Action = Literal["mark", "stop"]


class SetLimit(SetupTable):
    """Table ``[limits.NAME]``: what a channel must not leave, in its unit."""

    low: Number | None = None
    high: Number | None = None
    action: Action = "mark"

    @model_validator(mode="after")
    def _consistent(self) -> SetLimit:
        if self.low is None and self.high is None:
            raise ValueError("low or high is needed")
        if self.low is not None and self.high is not None and not self.low < self.high:
            raise ValueError(f"low must be below high, not {self.low:g} and {self.high:g}")
        return self


class SetEnvelope(SetupTable):
    """Table ``[envelope]``: the loads that the balance may bear together.

    The largest load of each component alone is that of its ``[limits.NAME]``, or else half of its range; a component
    that has neither does not count. With ``stations`` for a shape, only the tables ``[stations.NAME]`` do, and with
    ``balance`` the capacities of the balance matrix beside them.
    """

    shape: Literal["box", "rhombus", "ellipsoid", "stations", "balance"] | None = None
    action: Action = "mark"


class SetStation(SetupTable):
    """Table ``[stations.NAME]``: a load at one place of the balance, made up of several components, and its limit.

    ``NF`` to ``AF`` are what 1 N or 1 N*m of each adds to it.
    """

    limit: Above
    NF: Number = 0.0
    PM: Number = 0.0
    SF: Number = 0.0
    YM: Number = 0.0
    RM: Number = 0.0
    AF: Number = 0.0

    @model_validator(mode="after")
    def _consistent(self) -> SetStation:
        if not any(getattr(self, name) for name in COMPONENTS):
            raise ValueError("the share of one component at least is needed, such as NF = 0.5")
        return self

    def station(self, name: str) -> Station:
        """Make the station."""
        return Station(name, self.limit, {item: share for item in COMPONENTS if (share := getattr(self, item))})


class SetShunt(SetupTable):
    """Table ``[shunt.NAME]``: what the shunt resistor changes a channel by.

    Either ``change``, in the channel's unit, as it was when the balance was calibrated, or the ``resistance`` of the
    shunt across one arm of a ``bridge`` of four equal ones, which makes it in mV/V.
    """

    change: Number | None = None
    resistance: Above | None = None
    bridge: Above = 350.0
    uncertainty: NotBelow = 0.0
    tolerance: Above = SHUNT_TOLERANCE

    @model_validator(mode="after")
    def _consistent(self) -> SetShunt:
        if (self.change is None) == (self.resistance is None):
            raise ValueError("change or resistance is needed, and not both")
        if self.change == 0:
            raise ValueError("change must not be zero")
        return self

    @property
    def output(self) -> float | None:
        """Change of the bridge's output [mV/V]; None where the change of the channel is given."""
        return None if self.resistance is None else shunt_output(self.bridge, shunt_resistance=self.resistance)


class SetFouling(SetupTable):
    """Table ``[fouling]``: the contact circuit between model and support, and what a load must return to.

    The circuit is closed from `level` on, in the channel's unit, ``above`` or ``below``. ``tolerance`` is the largest
    departure of a load from zero after a release, over half of its range.
    """

    channel: Name | None = None
    level: Number | None = None
    closed: Literal["above", "below"] = "above"
    hold: Annotated[float, Field(ge=0, le=10)] = HOLD
    action: Action = "mark"
    tolerance: Above = RETURN_TOLERANCE

    @model_validator(mode="after")
    def _consistent(self) -> SetFouling:
        if (self.channel is None) != (self.level is None):
            raise ValueError("channel and level go together")
        return self
