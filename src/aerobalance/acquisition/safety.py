"""Tables of a test set-up (TOML) for the limits of the balance and for its checks before a run.

Limits of channels, combined load envelope, shunt calibration, and contact between model and support. Each class is one
table, as pydantic reads it; `aerobalance.acquisition.setup` puts them together.
"""

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
    """Table ``[limits.NAME]``: the range that a channel must not leave, ``low`` to ``high`` in its unit.

    With ``action = "mark"`` a departure is written into the record, ``"stop"`` ends it; so too in the tables below.
    """

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

    The shapes are those of `aerobalance.balance.load_envelope`. The largest load of each component alone is that of
    its ``[limits.NAME]``, or else half of its range; a component that has neither does not count. With the
    shape ``stations`` only the tables ``[stations.NAME]`` count, and with ``balance`` the capacities of the balance
    matrix as well.
    """

    shape: Literal["box", "rhombus", "ellipsoid", "stations", "balance"] | None = None
    action: Action = "mark"


class SetStation(SetupTable):
    """Table ``[stations.NAME]``: a load at one place of the balance, made up of several components, and its limit.

    ``NF`` to ``AF`` say by how much 1 N or 1 N*m of each component raises it [N or N*m], and ``limit`` is its largest
    size in the same unit.
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
        """Return the station of this name, with its limit and shares [N or N*m]."""
        return Station(name, self.limit, {item: share for item in COMPONENTS if (share := getattr(self, item))})


class SetShunt(SetupTable):
    """Table ``[shunt.NAME]``: the change of a channel that the shunt resistor must make.

    Either ``change`` is given, in the channel's unit, as it was when the balance was calibrated, or ``resistance`` of
    the shunt [ohm], across one of the four equal arms of the bridge, each of ``bridge`` [ohm]; then the change is in
    mV/V. 350 ohm is usual in transducers. ``uncertainty`` is the standard uncertainty of the
    change, ``tolerance`` its largest departure, both relative to it [1].
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
        """Change of the bridge's output that follows from resistances [mV/V]; None where ``change`` is given."""
        return None if self.resistance is None else shunt_output(self.bridge, shunt_resistance=self.resistance)


class SetFouling(SetupTable):
    """Table ``[fouling]``: the circuit that shows contact of model and support, and the check of the return to zero.

    The circuit counts as closed where ``channel`` reads ``level`` or more (``closed = "above"``) or ``level`` or less
    (``"below"``), in its unit, and a contact is over once it has stayed open for
    ``hold`` [s]. ``tolerance`` is the largest departure of a load
    from zero after the model was pushed and let go, relative to half of its range [1].
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
