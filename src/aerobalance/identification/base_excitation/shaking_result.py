"""What shaken records tell about coupled components, what they leave open, and which shake would help most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.rigid_body import inertial_loads
from aerobalance.identification.base_excitation.shaking_fit import (
    DELAY,
    MATRICES,
    ShakeParameters,
    evaluate,
    jacobian,
    products_of,
)
from aerobalance.identification.base_excitation.shaking_mass import Joint, ShakenMass
from aerobalance.identification.base_excitation.shaking_record import ShakeRecord
from aerobalance.identification.coupled.free_response import Complex
from aerobalance.identification.coupled.result import (
    CoupledResult,
    colour_warnings,
    force_error_warnings,
)
from aerobalance.identification.force_error import error_of, force_weights, highest_of
from aerobalance.motion.sensors import motion_name
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, MOMENTS

LEVEL: Final = 1.0
"""Rms of the acceleration of a further shake where the records have none to go by [m/s^2]."""


@dataclass(frozen=True, slots=True, eq=False)
class ShakeFound:
    """What was found of one record.

    Attributes
    ----------
    name
        The recording.
    duration, band
        Its length [s], and the lowest and highest frequency used [Hz].
    motion_rms
        Rms of the ground's six motions there, noise taken off, shape (6,) [m/s^2, rad/s^2].
    seen
        Motions that the sensors show; the others are taken as none.
    visibility
        Root of the energy of every mode over the noise of one reading, shape (modes,).
    share
        What the window leaves of the information, between 0 and 1.
    """

    name: str
    duration: float
    band: tuple[float, float]
    motion_rms: Array
    seen: tuple[str, ...]
    visibility: Array
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class ShakeAdvice:
    """What one further record, shaken along one motion of the ground end, would bring.

    Attributes
    ----------
    sizes
        Rms of the shake in each motion, white over the band of the force error, shape (6,) [m/s^2, rad/s^2].
    duration
        Its length [s].
    errors
        Predicted force error by motion and component, shape (6, 6) [N, N*m].
    best
        Motion that brings the largest relative error down most.
    """

    sizes: Array
    duration: float
    errors: Array
    best: str


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ShakingIdentification(CoupledResult):
    """What shaken records tell about the six components.

    Attributes
    ----------
    shakes
        What was found of every record.
    advice
        What one further record would bring.
    rigid
        The rigid mass that the ground's motion moves, and its tests.
    delay
        Time by which the loads lag the ground's motion beyond what the channels' settings say, with its standard
        uncertainty [s].
    """

    shakes: tuple[ShakeFound, ...]
    advice: ShakeAdvice
    rigid: ShakenMass
    delay: tuple[float, float]


def felt_by_mode(record: ShakeRecord, fit: ShakeParameters, dynamics: CoupledDynamics) -> Complex:
    """Balance loads in every mode as the ground's motion sets it off, shape (modes, m, 6)."""
    poles, shapes, weights = dynamics.modal_form
    net = -(record.taken @ fit.numbers)
    s = 2j * np.pi * record.frequency
    up = np.flatnonzero(poles.imag > 0)
    up = up[np.argsort(np.abs(poles[up]))]
    found = []
    for place in up:
        one = (net @ weights[place] / (s - poles[place]))[:, None] * shapes[:, place]
        other = (net @ weights[place].conj() / (s - poles[place].conj()))[:, None] * shapes[:, place].conj()
        found.append(one + other)
    return np.array(found)


def visibility(record: ShakeRecord, fit: ShakeParameters, dynamics: CoupledDynamics) -> Array:
    """Root of the energy of every mode over the noise of one reading, shape (modes,)."""
    waves = felt_by_mode(record, fit, dynamics) @ np.linalg.inv(np.linalg.cholesky(fit.noise)).T
    return np.asarray(np.sqrt(2 * np.sum(np.abs(waves) ** 2, axis=(1, 2))))


def shake_advice(
    joint: Joint, fit: ShakeParameters, records: Sequence[ShakeRecord], *, mass: Array, applied: Array, sizes: Array
) -> ShakeAdvice:
    """Predict the force error with one record more, shaken in each motion in turn.

    A turn is taken to be as fast as makes the mass as heavy as in the other motions: over its radius of gyration.

    Parameters
    ----------
    joint, fit, records
        What was found, and from what.
    mass
        Mass matrix, shape (6, 6).
    applied, sizes
        Rms of the load for which the force error is predicted, and half ranges, shape (6,) [N, N*m].
    """
    dynamics = joint.dynamics()
    straight = [place for place, name in enumerate(COMPONENTS) if name not in MOMENTS]
    level = float(np.max([record.motion_rms[straight] for record in records])) or LEVEL
    levels = level / np.sqrt(np.diag(mass) / mass[straight[0], straight[0]])
    duration = float(np.median([record.duration for record in records]))
    rate = float(np.median([record.samples / record.duration for record in records]))
    highest = highest_of(dynamics)
    u = np.sqrt(np.diag(joint.covariance))
    own = np.linalg.inv(joint.covariance / np.outer(u, u))
    weights = force_weights(dynamics, sizes=applied)
    table = np.empty((6, 6))
    for motion in range(6):
        shaken = np.zeros(6)
        shaken[motion] = levels[motion] * np.sqrt(rate / (2 * highest))
        told = _told_by(fit, dynamics, shaken @ mass, shaken=shaken, highest=highest, duration=duration)
        covariance = np.linalg.inv(own + told * np.outer(u, u)) * np.outer(u, u)
        table[motion] = error_of(covariance[:MATRICES, :MATRICES], weights)
    best = int(np.argmin(np.max(table / sizes, axis=1)))
    return ShakeAdvice(levels, duration, table, COMPONENTS[best])


def _told_by(
    fit: ShakeParameters, dynamics: CoupledDynamics, taken: Array, *, shaken: Array, highest: float, duration: float
) -> Array:
    """Information on A, D and the mass in a record shaken white in one motion, shape (82, 82).

    Parameters
    ----------
    fit, dynamics
        What was found.
    taken, shaken
        Amplitudes of the loads that the motion takes, and of the motion, shape (6,) each.
    highest, duration
        Top of the band [Hz] and length [s].
    """
    poles = dynamics.poles[dynamics.poles.imag > 0] / (2 * np.pi)
    reach = np.concatenate([[0.0], 0.25 * 1.5 ** np.arange(16)])
    sides = np.concatenate([reach, -reach])
    fine = (np.abs(poles)[:, None] + np.abs(poles.real)[:, None] * sides).ravel()
    grid = np.unique(np.clip(np.concatenate([fine, np.linspace(0, highest, 129)]), 1e-3 * highest, highest))
    lines = np.sqrt(np.gradient(grid) * duration)[:, None]  # frequencies of the record for which each stands
    s = 2j * np.pi * grid[:, None]
    motion = (lines * shaken).astype(np.complex128)
    loads = -np.einsum("mij,mj->mi", dynamics.response(grid), lines * taken)
    record = ShakeRecord(
        name="",
        frequency=grid,
        loads=loads,
        rates=s * loads,
        seconds=s**2 * loads,
        motion=motion,
        taken=inertial_loads(motion),
        motion_noise=np.zeros((grid.size, 6, 6)),
        slopes={},
        unknown={},
        noise=np.sqrt(np.diag(fit.noise)),
        share=1.0,
        samples=grid.size,
        duration=duration,
        reach=np.ones(6),
        columns=tuple(range(6)),
    )
    plain = ShakeParameters(np.append(fit.values[:DELAY], 0.0), fit.noise, ())
    here = evaluate(record, plain)
    here = replace(here, rates=record.rates, seconds=record.seconds, motion=record.motion, taken=record.taken)
    products = products_of(jacobian(record, here, plain), here.residual, 1.0)
    by_delay = products[:DELAY, DELAY]  # which is free
    return np.asarray(products[:DELAY, :DELAY] - np.outer(by_delay, by_delay) / products[DELAY, DELAY])


def shaking_warnings(found: ShakingIdentification) -> list[str]:
    """What is doubtful about the identification from shaking."""
    place = COMPONENTS.index(found.advice.best)
    unit = "rad/s^2" if found.advice.best in MOMENTS else "m/s^2"
    notes = force_error_warnings(
        found,
        left_by="shaken records",
        energy=np.sum([shake.visibility**2 for shake in found.shakes], axis=0),
        remedy=(
            f"a shake of {found.advice.sizes[place]:.3g} {unit} rms to {found.band[1]:.4g} Hz over "
            f"{found.advice.duration:.3g} s in the ground's {motion_name(place)}"
        ),
        after=float((found.advice.errors[place] / found.half_range).max()),
    )
    return [*notes, *colour_warnings(found), *_mass_warnings(found)]


def _mass_warnings(found: ShakingIdentification) -> list[str]:
    """What is doubtful about the mass, the symmetries and the delay."""
    notes, rigid = [], found.rigid
    still = [place for place in range(6) if not any(COMPONENTS[place] in shake.seen for shake in found.shakes)]
    turned = rigid.implied is not None and rigid.implied[0] < 0
    if rigid.implied is not None and turned:
        notes.append(
            f"no mass matrix: the shaken records imply a negative mass, {rigid.implied[0]:.5g} kg: the ground's "
            "accelerations or the loads have the other sign; turn it in the channel map"
        )
    elif rigid.weighed is not None and not rigid.weighed.chance and rigid.implied is not None:
        notes.append(
            f"the shaken records imply a mass of {rigid.implied[0]:.5g} kg (u = {rigid.implied[1]:.2g}), not the one "
            "given: the gain of the accelerometers or of the balance is off, or the mass; the mass from the shaking "
            "is kept, as it is what takes the ground's motion out of the loads"
        )
    if rigid.mass is None and not turned:
        notes.append(
            "no mass matrix: that behind the ground's motion is not positive or stays open; gravity and ground motion "
            "cannot be taken out of the loads: shake along the other motions too, or give the weighed mass"
        )
    elif rigid.from_symmetry:
        moved = f" (no {', '.join(motion_name(place) for place in still)})" if still else ""
        notes.append(
            f"the ground's motion leaves a part of the mass matrix open{moved}; it is taken from A and a symmetric "
            "stiffness"
        )
    for test, what in (
        (rigid.rigidity, "the loads under the ground's motion are not those of a rigid mass"),
        (rigid.symmetry, "the stiffness is not symmetric: a balance matrix that is off, or a model that bends"),
        (rigid.reciprocity, "the damping is not symmetric, as it is not in a flow or with friction"),
    ):
        if test is not None and not test.chance:
            notes.append(f"{what} (chi2 {test.chi2:.3g} for {test.degrees_of_freedom} degrees of freedom)")
    if abs(found.delay[0]) > 5 * found.delay[1] and found.rigid.mass is not None:
        notes.append(
            f"the loads lag the ground's motion by {1e6 * found.delay[0]:.3g} us (u = {1e6 * found.delay[1]:.2g}); A "
            "and D allow for it, but `force` does not: give it as the delay of the channels"
        )
    return notes
