"""What a set of releases tells about coupled components, and what is doubtful about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aerobalance.identification.coupled.result import CoupledResult, colour_warnings, force_error_warnings
from aerobalance.identification.rigid_body import RigidMassFit
from aerobalance.identification.step_relaxation.model import Kind
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit


@dataclass(frozen=True, slots=True, eq=False)
class ReleaseFound:
    """What was found of one release.

    Attributes
    ----------
    name
        The recording.
    kind
        ``"release"``: held and let go at once. ``"ramp"``: let go over a duration. ``"free"``: no clean release from
        rest (a tap, or a recording that begins later); only the free decay was used.
    instant, u_instant
        Instant of the release, or of the first reading used, on the recording's clock, and its standard uncertainty
        [s]; zero where the decay is free.
    duration
        Time over which the load was let go [s].
    step
        Loads held before less loads after, shape (n,) [N, N*m]; NaN where the decay is free.
    shares
        Amplitude of every mode over the sum of all, each load over half of range, shape (modes,).
    visibility
        Root of the energy of every mode over the noise of one reading, shape (modes,).
    time, residuals
        Readings less fit, shape (m,) on the recording's clock [s] and (m, n) [N, N*m].
    """

    name: str
    kind: Kind
    instant: float
    u_instant: float
    duration: float
    step: Array
    shares: Array
    visibility: Array
    time: Array
    residuals: Array


@dataclass(frozen=True, slots=True, eq=False)
class ReleaseAdvice:
    """What one further release along each component would bring.

    Attributes
    ----------
    components
        Components along which a release is considered.
    sizes
        Load let go in each, shape (n,) [N, N*m].
    errors
        Predicted force error by release and component, shape (n, n) [N, N*m].
    best
        Component of the release that brings the largest relative error down most.
    """

    components: tuple[str, ...]
    sizes: Array
    errors: Array
    best: str


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CoupledIdentification(CoupledResult):
    """What a set of releases tells about coupled components.

    Attributes
    ----------
    releases
        What was found of every release.
    advice
        What one further release would bring.
    rigid
        The rigid mass behind A, and its tests; None where no mass was given or none was found.
    """

    releases: tuple[ReleaseFound, ...]
    advice: ReleaseAdvice
    rigid: RigidMassFit | None


def release_warnings(found: CoupledIdentification) -> list[str]:
    """What is doubtful about the identification from releases."""
    names = found.dynamics.components
    best = names.index(found.advice.best)
    notes = force_error_warnings(
        found,
        left_by="releases",
        energy=np.sum([release.visibility**2 for release in found.releases], axis=0),
        remedy=f"a release along {names[best]} of {found.advice.sizes[best]:.3g} {si_unit(names[best])}",
        after=float((found.advice.errors[best] / found.half_range).max()),
    )
    notes += colour_warnings(found)
    free = [release.name for release in found.releases if release.kind == "free"]
    if free:
        notes.append(
            f"the ringing of {', '.join(free)} is not that of a clean release from rest; only its free decay is used"
        )
    return notes
