"""Dynamics of a balance from recordings of any kind: released, shaken, of loads or of gauge outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Literal, get_args

from aerobalance.balance.calibration.fit import Calibration
from aerobalance.balance.loads import Loads
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.weighing.result import Weighing
from aerobalance.balance.zeros import Zero
from aerobalance.identification.base_excitation.rig import RigFit, identify_rig
from aerobalance.identification.base_excitation.shaking import identify_shaking
from aerobalance.identification.base_excitation.shaking_result import ShakingIdentification
from aerobalance.identification.free_decay.fit import DecayFit, identify_decay
from aerobalance.identification.from_outputs import identification_loads, with_sensitivity_error
from aerobalance.identification.impact.tap_point import TapPoint
from aerobalance.identification.impact.tap_result import ImpactFit, ImpactIdentification
from aerobalance.identification.impact.taps import identify_taps
from aerobalance.identification.step_relaxation.identify import identify_releases
from aerobalance.identification.step_relaxation.release_result import CoupledIdentification
from aerobalance.recording.blas_threads import one_blas_thread
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import FitError, one_or_more
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import corrected

Excitation = Literal["release", "base", "impact"]
"""What makes the balance ring: a load let go, the motion of the ground end, or taps of measured force."""

Mass = float | tuple[float, float] | Weighing
"""Mass [kg; kg*m for a moment]: exact, with its standard uncertainty, or as weighed."""


@one_blas_thread()
def identify(
    recordings: Recording | Loads | Sequence[Recording | Loads],
    *,
    mass: Mass | None = None,
    components: Sequence[str] | None = None,
    excitation: Excitation = "release",
    modes: int | Literal["auto"] | None = None,
    half_range: Mapping[str, float] | None = None,
    balance: BalanceMatrix | Calibration | None = None,
    zero: Zero | None = None,
    points: TapPoint | Sequence[TapPoint | None] | None = None,
) -> DecayFit | RigFit | ImpactFit | CoupledIdentification | ShakingIdentification | ImpactIdentification:
    """Dynamics of one component or of several, with their covariance, from recordings in which the balance rings.

    The result holds them as its ``dynamics``, and can be given where dynamics are asked for.

    Parameters
    ----------
    recordings
        Balance loads; or with `balance` gauge outputs. Loads that `identification_loads` made of gauge outputs bring
        their balance matrix along. One component needs one recording; coupled components need a release along each.
        Any number of recordings of taps serve either.
    mass
        Moving mass. One component that is released needs it; a shaken one tells it; coupled components get their
        mass matrix from it.
    components
        Components that are wanted; those that are in the recordings where left out. Several are taken as coupled.
    excitation
        ``"release"``: a load let go in every recording (free decay, step relaxation). ``"base"``: the ground end
        shaken, its motion recorded. ``"impact"``: taps with an instrumented hammer, its force recorded as
        ``impact_force``.
    modes
        Number of modes, or ``"auto"`` for those that the recordings show: the default for coupled components; one for
        a single one.
    half_range
        Half of range by component [N, N*m], for coupled components; the largest change of load where left out.
    balance, zero
        Where gauge outputs are given: the balance matrix or its calibration, and the zero that they count from.
    points
        Where taps were given and which way they push the model: one for all recordings, or one for each. Left out
        where the channels of the force say it, and for one component, along which the taps then are.

    Raises
    ------
    FitError
        The recordings lack a component, or do not tell the dynamics.
    ValueError
        An argument does not fit.
    """
    if excitation not in get_args(Excitation):
        raise ValueError(f"excitation must be release, base or impact, not {excitation!r}")
    if points is not None and excitation != "impact":
        raise ValueError("points are those of taps: give excitation='impact' as well")
    given: list[Recording | Loads] = one_or_more(recordings)
    if not given:
        raise ValueError("at least one recording is needed")
    if balance is None and zero is not None:
        raise ValueError("a zero is of gauge outputs: give the balance matrix that makes loads of them as well")
    weighing = mass if isinstance(mass, Weighing) else None
    loads = [one for one in given if isinstance(one, Loads)]
    outputs = [one for one in given if not isinstance(one, Loads)]
    if loads and (outputs or balance is not None):
        raise ValueError("loads that are reduced already go without recordings beside them and without balance")
    if balance is not None:
        loads = identification_loads(outputs, balance, zero=zero, weighing=weighing)
    records = [one.recording for one in loads] or [corrected(one) for one in outputs]
    names = _names(records, components)
    weighed = _weighed(mass, names)
    if excitation == "impact":
        return _tapped(records, names, loads, mass=weighed, modes=modes, half_range=half_range, points=points)
    if len(names) == 1:
        return _one(records, names[0], loads, mass=weighed, excitation=excitation, modes=modes)
    if excitation == "base":
        if modes is not None and modes != "auto":
            raise ValueError("modes cannot be given for several components that are shaken")
        if set(names) != set(COMPONENTS):
            raise ValueError(f"a shaken balance needs all of {', '.join(COMPONENTS)}; the recordings have {names}")
        return identify_shaking(records, mass=weighed, half_range=half_range)
    return identify_releases(
        records,
        components=names,
        mass=weighed,
        half_range=half_range,
        modes="auto" if modes is None else modes,
        errors=[one.matrix_errors for one in loads],
    )


def _tapped(
    recordings: Sequence[Recording],
    names: tuple[str, ...],
    loads: Sequence[Loads],
    *,
    mass: float | tuple[float, float] | None,
    modes: int | Literal["auto"] | None,
    half_range: Mapping[str, float] | None,
    points: TapPoint | Sequence[TapPoint | None] | None,
) -> ImpactFit | ImpactIdentification:
    """Dynamics of one component or of several, from taps."""
    errors = [one.matrix_errors for one in loads] if len(names) > 1 else []
    where = [points] * len(recordings) if points is None or isinstance(points, TapPoint) else points
    number = modes if modes is not None else ("auto" if len(names) > 1 else 1)
    return identify_taps(
        recordings, components=names, mass=mass, half_range=half_range, modes=number, points=where, errors=errors
    )


def _weighed(mass: Mass | None, names: tuple[str, ...]) -> float | tuple[float, float] | None:
    """Mass, with its standard uncertainty where it was weighed: that of one component, or of the whole model."""
    if not isinstance(mass, Weighing):
        numbers = mass if isinstance(mass, tuple | list) else (mass,)
        if mass is not None and not all(isinstance(one, Real) for one in numbers):
            raise ValueError(
                "mass is a number [kg], a number with its standard uncertainty, such as (12.8, 0.01), or a weighing, "
                f"not {mass!r}"
            )
        return mass
    if len(names) != 1:
        return mass.mass, mass.u_mass
    (component,) = names
    if component not in mass.masses:
        raise ValueError(f"the weighing has no mass of {component}; it has {', '.join(mass.masses)}")
    return mass.masses[component].mass, mass.masses[component].u


def _names(recordings: Sequence[Recording], components: Sequence[str] | None) -> tuple[str, ...]:
    if components is not None:
        return tuple(components)
    names = tuple(name for name in COMPONENTS if all(name in one for one in recordings))
    if not names:
        raise FitError(
            f"{recordings[0].name} has no balance load; it has {', '.join(recordings[0].channels) or 'no channels'}. "
            "Gauge outputs become loads by the balance matrix (balance=)"
        )
    return names


def _one(
    recordings: Sequence[Recording],
    component: str,
    loads: Sequence[Loads],
    *,
    mass: float | tuple[float, float] | None,
    excitation: Excitation,
    modes: int | Literal["auto"] | None,
) -> DecayFit | RigFit:
    """Dynamics of one component, of one recording."""
    if len(recordings) != 1:
        raise ValueError(f"one component is identified from one recording at a time, not from {len(recordings)}")
    (recording,) = recordings
    number = 1 if modes is None else modes
    if excitation == "base":
        if loads:
            recording = with_sensitivity_error(loads[0], component)
        return identify_rig(recording, component=component, mass=mass, modes=number)
    if mass is None:
        raise ValueError("mass is needed: a free decay tells stiffness and damping only in proportion to the mass")
    return identify_decay(recording, component=component, mass=mass, modes=number)
