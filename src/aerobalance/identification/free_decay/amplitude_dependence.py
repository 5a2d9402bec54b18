"""Whether damping and frequency of a ringing load depend on its amplitude: friction, a loose joint, a bent spring."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from aerobalance.identification.free_decay.waveform import Ring, fit_ring

SIGNIFICANT: Final = 5.0
"""Standard uncertainties from which a dependence is more than chance."""

PLAIN: Final = 0.05
"""Share of the squared residuals that a bent waveform takes away where bending is what is wrong with a fit."""

FALLEN: Final = 0.5
"""Amplitude at the end of the ringing over that at its start above which nothing can be told."""


@dataclass(frozen=True, slots=True)
class AmplitudeDependence:
    """Change of decay rate and frequency from the smallest to the largest amplitude of a ringing load, relative.

    Attributes
    ----------
    damping, u_damping
        Decay rate at the full amplitude less that at none, over the one fitted, and its standard uncertainty [1].
    frequency, u_frequency
        The same of the frequency [1].
    """

    damping: float
    u_damping: float
    frequency: float
    u_frequency: float

    @property
    def damping_depends(self) -> bool:
        """True when the damping depends on the amplitude by more than chance."""
        return abs(self.damping) > SIGNIFICANT * self.u_damping

    @property
    def frequency_depends(self) -> bool:
        """True when the frequency depends on the amplitude by more than chance."""
        return abs(self.frequency) > SIGNIFICANT * self.u_frequency


def bent_where_plain(ring: Ring) -> tuple[Ring, Ring]:
    """The ring, or a bent one in its place where that takes away much of what is left over, and the bent one.

    Done before anything else is looked for: what a bent ringing leaves over looks like lines beside the ringing.
    """
    bent = _again(ring, bent=True)
    return (bent if bent.squares < (1 - PLAIN) * ring.squares else ring), bent


def amplitude_dependence(ring: Ring, *, bent: Ring | None = None) -> tuple[AmplitudeDependence | None, Ring]:
    """Test a fitted ringing for a decay rate and a frequency that change in proportion to the envelope.

    Parameters
    ----------
    ring
        The fit.
    bent
        The same with a decay rate and a frequency that may change, where that is fitted already.

    Returns
    -------
    dependence
        None where the residuals are rounding, or the ringing does not fall enough to tell.
    ring
        The fit itself, bent where one of the two is significant and else not.
    """
    fallen = np.exp(-ring.decay * (float(ring.time[-1]) - ring.start))
    straight = _again(ring, bent=False) if ring.bent else ring
    if bent is None:
        bent = ring if ring.bent else _again(ring, bent=True)
    if ring.variance < (1e-9 * ring.amplitude) ** 2 or fallen > FALLEN:
        return None, straight
    height = bent.height if bent.shape != "free" else bent.amplitude
    u = np.sqrt(np.diag(bent.covariance)[-2:]) / abs(height)
    change = bent.sizes[-2:] / height
    found = AmplitudeDependence(float(change[0]), float(u[0]), float(change[1]), float(u[1]))
    return found, bent if found.damping_depends or found.frequency_depends else straight


def _again(ring: Ring, *, bent: bool) -> Ring:
    """Fit the same ringing again, bent or not."""
    return fit_ring(ring.time, ring.values, ring, lines=ring.lines, bent=bent)
