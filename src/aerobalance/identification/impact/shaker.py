"""Identification of one component from a shaker on the model: a measured force that acts all along.

X + D X' + A X'' = h is the response to a ground acceleration -h / M of a mass M. So it is the fit of a shaken ground
end, with noise in loads and in force, that finds the dynamics here: M then is the force over its reading, as the
balance shows it.
"""

from __future__ import annotations

import warnings
from typing import Final, Literal

import numpy as np

from aerobalance.dynamics.single import Dynamics
from aerobalance.identification.base_excitation.rig import RigFit, damping_note, identify_rig
from aerobalance.identification.impact.tap_doubts import FROM_DAMPING, damping_hardly_told
from aerobalance.identification.impact.tap_point import U_GAIN, TapPoint, fit_point
from aerobalance.identification.impact.tap_result import ImpactFit, Taps
from aerobalance.recording.channel import IMPACT_FORCE, Channel
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import DataQualityWarning, FitError, warn_quality
from aerobalance.recording.recording import Recording

STRONG: Final = 0.05
"""Force over the largest in the recording that counts as acting."""

ALL_ALONG: Final = 0.2
"""Share of the readings with such a force from which it is a shaker's: taps last some thousandths of the time."""

FAR: Final = 5.0
"""Standard uncertainties by which the gain of a force must be off to be doubted."""


def is_shaken(recording: Recording) -> bool:
    """Return whether the measured force acts all along, as that of a shaker does."""
    if IMPACT_FORCE not in recording:
        return False
    values = recording.channel(IMPACT_FORCE).values
    known = values[np.isfinite(values)]
    if not known.size:
        return False
    size = np.abs(known - np.median(known))
    noisy = float(np.median(size)) > 0.5 * float(size.max()) / np.sqrt(2 * np.log(max(known.size, 2)))
    acting = float(np.mean(size > STRONG * size.max())) > ALL_ALONG
    return acting and not (noisy and _white(known))


def _white(values: np.ndarray) -> bool:
    """Whether neighbouring readings have nothing to do with each other, as those of noise alone."""
    centred = values - values.mean()
    power = float(centred @ centred)
    return power == 0 or abs(float(centred[1:] @ centred[:-1])) < 5 / np.sqrt(values.size) * power


def identify_shaker(
    recording: Recording,
    *,
    component: str,
    mass: float | tuple[float, float],
    modes: int | Literal["auto"] = 1,
    point: TapPoint | None = None,
) -> ImpactFit:
    """Identify one component from a shaker of measured force on the model.

    Parameters
    ----------
    recording
        The load and ``impact_force``.
    component
        The load channel.
    mass
        Moving mass [kg; kg*m for a moment], exact or with its standard uncertainty.
    modes
        Number of modes, or ``"auto"`` for those that the record shows.
    point
        Where the shaker pushes and which way; None for along the component.

    Raises
    ------
    FitError
        The load does not answer the force, or the record does not tell the dynamics.
    """
    loads = fit_point(point, (component,), np.ones(1))
    lever = float(loads.loads[0])
    if abs(lever) < 1e-6:
        raise FitError(f"{recording.name}: a force at {loads.name} does not load {component}")
    found, sign, said = _either_sign(recording, component, lever, modes)
    rig = found.dynamics
    gain, u_gain = sign * rig.mass, rig.uncertainty("mass")
    channel = recording.channel(IMPACT_FORCE)
    u_stated = float(np.hypot(channel.relative_uncertainty or U_GAIN, np.linalg.norm(loads.root) / abs(lever)))
    doubts = _doubts(gain, u_gain, u_stated, component)
    dynamics = _with_mass(rig, mass)
    # that note has the damping of the fit, whose mass is the gain; the doubt has the damping found
    said = [text for text in said if text != damping_note(rig)]
    doubts += damping_hardly_told(dynamics, "the record", "push nearer to the natural frequency, or for longer")
    told = [*map(str, doubts), *said]
    for text in told:
        warn_quality(f"{recording.name}: {text}")
    level = np.array([float(np.sqrt(np.mean(found.residual_level**2)))])
    taps = Taps(
        taps=(),
        points=(loads.name,),
        gain=(gain, u_gain),
        delay=(-rig.delay, rig.uncertainty("delay")),
        corner=0.0,
        responses=(),
        residual_deviation=level,
        reduced_chi2=np.array([found.chi2 / found.degrees_of_freedom]),
        degrees_of_freedom=found.degrees_of_freedom,
        doubts=tuple(doubts),
    )
    return ImpactFit(dynamics, taps, tuple(told))


def _either_sign(
    recording: Recording, component: str, lever: float, modes: int | Literal["auto"]
) -> tuple[RigFit, int, list[str]]:
    """The fit with the force as it reads or turned, that sign, and what was said of it."""
    problem: FitError | None = None
    first = _sign_of(recording, component, lever)
    for sign in (first, -first):
        values = -sign * lever * recording.channel(IMPACT_FORCE).values
        name = "ground_acceleration"  # of no axis: the force drives any component as the ground does
        force = recording.channel(IMPACT_FORCE)
        noise = None if force.noise is None else abs(lever) * force.noise
        moved = Channel(name, values, "m/s^2", noise=noise, delay=force.delay)
        made = Recording.from_columns(
            recording.time, {component: recording.channel(component), name: moved}, name=recording.name
        )
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always", DataQualityWarning)
                found = identify_rig(made, component=component, modes=modes)
        except (FitError, ValueError) as error:
            problem = problem or FitError(_of_force(str(error)))
            continue
        texts = [str(one.message) for one in caught if issubclass(one.category, DataQualityWarning)]
        return found, sign, list(dict.fromkeys(_of_force(text.removeprefix(f"{recording.name}: ")) for text in texts))
    raise problem or FitError(f"{recording.name}: the load does not answer the force")


def _sign_of(recording: Recording, component: str, lever: float) -> int:
    """Sign with which the force puts power into the balance: on average it pushes with the motion."""
    load, force = recording.channel(component).values, recording.channel(IMPACT_FORCE).values
    moving = load[2:] - load[:-2]
    both = np.isfinite(moving) & np.isfinite(force[1:-1])
    inner = force[1:-1][both] - np.mean(force[1:-1][both])
    return -1 if lever * float(inner @ moving[both]) < 0 else 1


def _of_force(text: str) -> str:
    """Words about a shaken ground end as words about a shaker."""
    for given, said in (
        ("load and ground acceleration", "load and force"),
        ("ground_acceleration", IMPACT_FORCE),
        ("ground acceleration", "force"),
        ("another force on the live end", "another force on the model"),
    ):
        text = text.replace(given, said)
    return text


def _with_mass(rig: Dynamics, mass: float | tuple[float, float]) -> Dynamics:
    """Dynamics with the weighed mass, of which the fit tells frequency and damping."""
    value, u = mass if isinstance(mass, tuple) else (mass, 0.0)
    size = rig.covariance.shape[0]
    slopes = np.eye(size)
    slopes[:3] = 0.0
    slopes[1, :2] = -value * rig.stiffness / rig.mass**2, value / rig.mass
    slopes[2, 0], slopes[2, 2] = -value * rig.damping / rig.mass**2, value / rig.mass
    slopes[3] = 0.0  # the delay found is that of the force
    covariance = slopes @ rig.covariance @ slopes.T
    by_mass = np.zeros(size)
    by_mass[:3] = 1.0, rig.stiffness / rig.mass, rig.damping / rig.mass
    covariance += u**2 * np.outer(by_mass, by_mass)
    return Dynamics(
        rig.component,
        value,
        value * rig.stiffness / rig.mass,
        value * rig.damping / rig.mass,
        covariance=(covariance + covariance.T) / 2,
        further_modes=rig.further_modes,
    )


def _doubts(gain: float, u_gain: float, u_stated: float, component: str) -> list[Doubt]:
    """What is doubted of the force's gain, which is found and does no harm."""
    if abs(gain - 1) < FAR * np.hypot(u_gain, u_stated):
        return []
    advice = "check the sensitivity of the force's channel, its sign, and where and which way the shaker pushes"
    if gain < 0:
        text = f"the force has the other sign, and is {abs(gain):.4g} times its reading"
        return [Doubt("force sign", component, text, advice, 0.0, "1")]
    known = min(u_stated, FROM_DAMPING)
    text = (
        f"the force is {gain:.4g} (u = {u_gain:.1g}) times its reading as the balance shows it, where it should be "
        f"known to {100 * known:.2g} %; the balance's own calibration is taken"
    )
    return [Doubt("force gain", component, text, advice, 0.0, "1")]
