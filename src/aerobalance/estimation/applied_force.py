"""The forces and moments applied along a record, with what they were worked out from."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from aerobalance.balance.loads import Loads
from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.estimation.display import html, plot, summary, to_dataframe, to_xarray
from aerobalance.estimation.forces import ForceRecord, ForceSettings
from aerobalance.estimation.result import ComponentForce
from aerobalance.estimation.spectra.noise_spectrum import NoiseSpectrum
from aerobalance.recording.channel import Array
from aerobalance.recording.doubts import Assumption, Doubt, Size, Verdict, verdict_of
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import interpolate_gaps

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, eq=False)
class Force(Mapping[str, ComponentForce]):
    """The forces and moments applied, by component, with what they were worked out from.

    ``force["NF"].values`` and ``force["NF"].uncertainty`` are the force and its standard uncertainty [N].

    Attributes
    ----------
    parts
        The force of each component.
    made_of
        Gives `record` and `loads`.
    settings
        How the forces were worked out.
    noises
        Spectra of the noise of the components' readings, where a record of noise was given.
    worst
        Gives the force of the part with the largest uncertainty, and what to say of that, where the record was worked
        out in parts; else None.
    """

    parts: Mapping[str, ComponentForce]
    made_of: Callable[[], tuple[ForceRecord, Loads | None]]
    settings: ForceSettings = field(default_factory=ForceSettings)
    noises: Mapping[str, NoiseSpectrum] = field(default_factory=dict)
    worst: Callable[[], tuple[Force, str]] | None = None

    def __getitem__(self, component: str) -> ComponentForce:
        if component not in self.parts:
            raise KeyError(f"there is no force along {component!r}; there are {', '.join(self.parts)}")
        return self.parts[component]

    def __iter__(self) -> Iterator[str]:
        return iter(self.parts)

    def __len__(self) -> int:
        return len(self.parts)

    def to_dataframe(self) -> pd.DataFrame:
        """Forces and their standard uncertainties, ``NF`` and ``u_NF`` [N, N*m], over the time [s]."""
        return to_dataframe(self, self.recording)

    def to_xarray(self) -> xr.Dataset:
        """Forces and their standard uncertainties, ``NF`` and ``u_NF``, along ``time`` [s], with their units."""
        return to_xarray(self, self.recording)

    def plot(self) -> Figure:
        """Figure of the forces with bands of 95 %, above the balance loads; one component below the other."""
        return plot(self, self.recording)

    def __repr__(self) -> str:
        return summary(self, self.recording, self.verdict)

    def _repr_html_(self) -> str:
        return html(self, self.recording, self.verdict)

    @property
    def only(self) -> ComponentForce:
        """The force of the one component there is.

        Raises
        ------
        ValueError
            There are several.
        """
        if len(self.parts) != 1:
            raise ValueError(f'there are several components, {", ".join(self.parts)}: name one, as in force["NF"]')
        return next(iter(self.parts.values()))

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """What the record says against the forces of all components."""
        return tuple(doubt for part in self.parts.values() for doubt in part.doubts)

    @property
    def assumed(self) -> tuple[Assumption, ...]:
        """What the record cannot show and is not in the uncertainties, with what it would do to the forces."""
        return tuple(one for part in self.parts.values() for one in part.assumed)

    @property
    def verdict(self) -> Verdict:
        """Whether the forces may be used (fit for use, doubtful or not usable)."""
        return verdict_of(self.doubts, {name: size_of(part) for name, part in self.parts.items()})

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the n components."""
        return tuple(self.parts)

    @property
    def record(self) -> ForceRecord:
        """The balance loads, with the dynamics and the motion of the ground that go with them."""
        return self.made_of()[0]

    @property
    def loads(self) -> Loads | None:
        """The loads with their matrix, where they come from gauge outputs; None where loads were given."""
        return self.made_of()[1]

    @property
    def recording(self) -> Recording:
        """The run with its balance loads: clock, motion and attitude."""
        return self.record.recording

    @property
    def dynamics(self) -> BalanceDynamics:
        """The dynamics that the forces were worked out with."""
        return self.record.dynamics

    @property
    def filled(self) -> Array:
        """Readings of the components with their gaps filled by what the forces make the balance read, (samples, n)."""
        filled = interpolate_gaps(self.record.loads)
        if not self.record.has_gaps:
            return filled
        return self.record.filled_by({name: one.values for name, one in self.parts.items()}, filled=filled)


def size_of(force: ComponentForce) -> Size:
    """Return how large a force is that is held in memory."""
    values = force.values[np.isfinite(force.values)]
    u = force.uncertainty[np.isfinite(force.uncertainty)]
    return Size(float(np.sqrt(np.mean(u**2))), float(np.std(values)), float(np.mean(values)))
