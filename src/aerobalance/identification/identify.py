"""Dynamics of a balance from recordings of any kind: released, shaken, of loads or of gauge outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from aerobalance.balance.calibration.fit import Calibration, matrix_of
from aerobalance.balance.loads import Loads
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.reduction import reduce_outputs
from aerobalance.balance.weighing.result import Weighing
from aerobalance.balance.weight_on_zero import NotWeighed
from aerobalance.balance.zeros import Zero
from aerobalance.identification.base_excitation.rig import RigFit, identify_rig
from aerobalance.identification.base_excitation.shaking import identify_shaking
from aerobalance.identification.base_excitation.shaking_result import ShakingIdentification
from aerobalance.identification.free_decay.fit import DecayFit, identify_decay
from aerobalance.identification.result import CoupledIdentification
from aerobalance.identification.step_relaxation.identify import identify_releases
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY
from aerobalance.recording.errors import FitError, warn_quality
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import corrected

Excitation = Literal["release", "base"]
"""What makes the balance ring: a load let go, or the motion of the ground end."""

Mass = float | tuple[float, float] | Weighing
"""Mass [kg; kg*m for a moment]: exact, with its standard uncertainty, or as weighed."""


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
) -> DecayFit | RigFit | CoupledIdentification | ShakingIdentification:
    """Dynamics of one component or of several, with their covariance, from recordings in which the balance rings.

    The result holds them as its ``dynamics``, and can be given where dynamics are asked for.

    Parameters
    ----------
    recordings
        Balance loads; or with `balance` gauge outputs. Loads that `identification_loads` made of gauge outputs bring
        their balance matrix along. One component needs one recording; coupled components need a release along each.
    mass
        Moving mass. One component that is released needs it; a shaken one tells it; coupled components get their
        mass matrix from it.
    components
        Components that are wanted; those that are in the recordings where left out. Several are taken as coupled.
    excitation
        ``"release"``: a load let go in every recording (free decay, step relaxation). ``"base"``: the ground end
        shaken, its motion recorded.
    modes
        Number of modes, or ``"auto"`` for those that the recordings show: the default for coupled components; one for
        a single one.
    half_range
        Half of range by component [N, N*m], for coupled components; the largest change of load where left out.
    balance, zero
        Where gauge outputs are given: the balance matrix or its calibration, and the zero that they count from.

    Raises
    ------
    FitError
        The recordings lack a component, or do not tell the dynamics.
    ValueError
        An argument does not fit.
    """
    if excitation not in get_args(Excitation):
        raise ValueError(f"excitation must be release or base, not {excitation!r}")
    given = [recordings] if isinstance(recordings, Recording | Loads) else list(recordings)
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
    if len(names) == 1:
        return _one(records, names[0], loads, mass=mass, excitation=excitation, modes=modes)
    weighed = (weighing.mass, weighing.u_mass) if isinstance(mass, Weighing) and weighing is not None else mass
    if isinstance(weighed, Weighing):
        raise TypeError("a weighing has become a mass by now")
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
    mass: Mass | None,
    excitation: Excitation,
    modes: int | Literal["auto"] | None,
) -> DecayFit | RigFit:
    """Dynamics of one component, of one recording."""
    if len(recordings) != 1:
        raise ValueError(f"one component is identified from one recording at a time, not from {len(recordings)}")
    (recording,) = recordings
    if isinstance(mass, Weighing):
        if component not in mass.masses:
            raise ValueError(f"the weighing has no mass of {component}; it has {', '.join(mass.masses)}")
        mass = (mass.masses[component].mass, mass.masses[component].u)
    number = 1 if modes is None else modes
    if excitation == "base":
        if loads:
            recording = with_sensitivity_error(loads[0], component)
        return identify_rig(recording, component=component, mass=mass, modes=number)
    if mass is None:
        raise ValueError("mass is needed: a free decay tells stiffness and damping only in proportion to the mass")
    return identify_decay(recording, component=component, mass=mass, modes=number)


def identification_loads(
    recordings: Sequence[Recording],
    balance: BalanceMatrix | Calibration,
    *,
    zero: Zero | None = None,
    tare: Sequence[Recording] = (),
    weighing: Weighing | None = None,
    calibration_counts: bool = True,
) -> list[Loads]:
    """Balance loads [N, N*m] of recordings of gauge outputs that dynamics are to be identified from.

    What hangs on the balance does not change the ringing. But bridges that are curved ring as where they are, so the
    weight in a zero that was read with the model on is put back, as far as a weighing or natural zeros tell it.

    Parameters
    ----------
    recordings
        Gauge outputs.
    balance
        The balance matrix, or its calibration.
    zero
        What the outputs count from.
    tare
        Wind-off recordings whose loads are taken off.
    weighing
        What hangs on the balance; None where it is not known.
    calibration_counts
        Whether what the calibration leaves is to be counted, for which the matrix must hold it.
    """
    matrix = matrix_of(balance)
    gravity = STANDARD_GRAVITY if weighing is None else weighing.gravity
    model = NotWeighed() if weighing is None else weighing
    found = [reduce_outputs(one, matrix, zero=zero, model=model, tare=tare, gravity=gravity) for one in recordings]
    if calibration_counts and not matrix.covariance.any():
        warn_quality(
            "the balance matrix holds no covariance of its coefficients; what its calibration leaves in the dynamics "
            "is not known"
        )
    return found


def with_sensitivity_error(loads: Loads, component: str) -> Recording:
    """The recording of balance loads, with what the calibration leaves of a sensitivity as uncertainty of its gain."""
    channel, place = loads.recording.channel(component), loads.components.index(component)
    size = float(np.ptp(channel.values)) / 2
    alone = np.asarray(np.linalg.inv(loads.transform)[:, place] * size, dtype=np.float64)
    covariance = loads.balance.load_covariance(alone[None, :], residual=False)[0]
    own = loads.transform[place]
    relative = float(np.sqrt(max(own @ covariance @ own, 0.0))) / size if size > 0 else 0.0
    known = replace(channel, relative_uncertainty=float(np.hypot(channel.relative_uncertainty, relative)))
    return replace(loads.recording, channels={**loads.recording.channels, component: known})
