"""Identification of moving mass, stiffness and damping from a shaken ground end, by the complex response.

Stepped, swept and random excitation are one problem: in the discrete Fourier transform of the whole record the load
is Y = H U + T, with H = -M exp(-i w tau) / D, D = 1 - (w/w0)^2 + i w b/k, the same for all of them (the complex form
1 + M x1''/AF = (w/w0)^2 - i w b/k of Eqs. (11) and (12)), and T the few terms that a motion already going on at the
ends of the record adds. Both channels are noisy, so the likelihood is that of errors in both.

With several modes 1 / D is the sum of the modes' own, each times its share of a steady load. The shares found here are
those of the load from the ground's motion, as `force` needs them to take it out, and not those of a load at one place
on the model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from aerobalance.dynamics.modal import Mode
from aerobalance.dynamics.single import Dynamics
from aerobalance.identification.base_excitation.frf_model import Problem
from aerobalance.identification.base_excitation.further_modes import one_more_mode, with_further_modes
from aerobalance.identification.base_excitation.live_check import LiveCheck, live_check
from aerobalance.identification.base_excitation.maximum_likelihood import HIGHEST, Estimate, maximise
from aerobalance.identification.base_excitation.spectra import excited, transform
from aerobalance.recording.channel import Array
from aerobalance.recording.components import driving_channel
from aerobalance.recording.errors import FitError, argument, warn_quality
from aerobalance.recording.recording import Recording
from aerobalance.recording.wording import damping_text, share_text


@dataclass(frozen=True, slots=True)
class ShakenRigSettings:
    """Thresholds of the identification on a shaken rig.

    Attributes
    ----------
    doubtful_damping
        Relative standard uncertainty of the damping above which it is called hardly identifiable.
    doubtful_mass
        Departure of the mass that the response implies from the one given, relative, that is worth a word.
    most_modes
        Modes that are looked for at most.
    least_blocks
        Blocks of frequencies that a narrowed band keeps at least.
    doubtful_correlation
        Correlation of damping and delay above which the record hardly tells them apart.
    """

    doubtful_damping: float = 0.1
    doubtful_mass: float = 0.01
    most_modes: int = 5
    least_blocks: int = 8
    doubtful_correlation: float = 0.95


SETTINGS: Final = ShakenRigSettings()
"""Thresholds that are used."""


@dataclass(frozen=True, slots=True, eq=False)
class RigFit:
    """What a shaken record tells about one component.

    Attributes
    ----------
    dynamics
        Mass, stiffness, damping, delay and further modes with their covariance; the shares of the modes are those of
        a load from the ground's motion.
    mass_identified
        Whether the mass was found from the record, or given.
    band
        Lowest and highest frequency used [Hz].
    chi2, degrees_of_freedom
        Sum of squared residuals over the noise of the two channels, and the number expected of it.
    residual_frequency, residual_level
        Centres of the blocks of frequencies used [Hz] and the root-mean-square residual of the load in each, as the
        standard deviation of white noise of that level [N; N*m], shape (blocks,).
    expected_level
        The same as the noise of both channels lets expect, shape (blocks,).
    coherence
        Squared coherence of load and ground acceleration in these blocks, shape (blocks,).
    coloured
        Whether the residual spectrum, not the noise floor, set the weights.
    left_out
        A further mode that the record shows but the dynamics leave out, or None.
    live
        Check by the live accelerometer, None where there is none.
    notes
        What a reader of the result should know, each a sentence.
    """

    dynamics: Dynamics
    mass_identified: bool
    band: tuple[float, float]
    chi2: float
    degrees_of_freedom: int
    residual_frequency: Array
    residual_level: Array
    expected_level: Array
    coherence: Array
    coloured: bool
    left_out: Mode | None
    live: LiveCheck | None
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        mass = "identified" if self.mass_identified else "given"
        return f"shaken ground end, mass {mass}; {self.dynamics!r}"


def identify_rig(
    recording: Recording,
    *,
    component: str = "AF",
    mass: float | tuple[float, float] | None = None,
    modes: int | Literal["auto"] = 1,
    band: tuple[float, float] | None = None,
    delay: float | None = None,
) -> RigFit:
    """Identify the dynamics of one component from a record with a shaken ground end and no force on the live end.

    Parameters
    ----------
    recording
        Recording with the load, the acceleration of the ground end along it (`ground_acceleration_z` for NF, `_y` for
        SF; else `ground_acceleration`) and, for a check, that of the live end of the same ending. Delays that the
        channels carry are removed first; the delay found is what is left.
    component
        The load channel.
    mass
        Moving mass [kg; kg*m for a moment], exact, or with its standard uncertainty; None to identify it.
    modes
        How many modes the dynamics have; ``"auto"``: as many as the record gives evidence of, five at most.
    band
        Lowest and highest frequency to use [Hz]; by default every frequency at which the load answers the ground.
    delay
        Delay of the load behind the ground acceleration [s] where it is known; by default identified.

    Returns
    -------
    RigFit

    Raises
    ------
    FitError
        The record cannot carry the result, or shows fewer modes than asked for.
    """
    value, uncertainty = _mass(mass)
    if modes != "auto" and not 1 <= modes <= SETTINGS.most_modes:
        raise ValueError(f"modes must be auto or a number from 1 to {SETTINGS.most_modes}, not {modes}")
    if band is not None and not 0 <= band[0] < band[1]:
        raise ValueError(f"band must be two frequencies in rising order, not {band}")
    spectra = excited(transform(recording, component), band=band, name=recording.name)
    problem = Problem(spectra=spectra, mass=value, delay=delay)
    ground = driving_channel("ground", component, recording)
    gains = [recording.channel(name).relative_uncertainty for name in (component, ground)]
    gain = float(np.linalg.norm(gains))
    looseness = 0.0 if value is None else float(np.hypot(uncertainty / value, gain))
    fitted = _described(problem, modes, name=recording.name, fixed_band=band is not None, looseness=looseness)
    problem, estimate = fitted.problem, fitted.estimate
    spectra = problem.spectra
    dynamics = _dynamics(
        estimate, problem, component=component, uncertainty=uncertainty, gain=gain, name=recording.name
    )
    live = live_check(estimate, problem)
    notes = _notes(dynamics, estimate, problem=problem, live=live, component=component)
    notes += _mass_notes(fitted.implied, value, looseness) + _left_out_notes(fitted.left_out, modes)
    for note in notes:
        warn_quality(f"{recording.name}: {note}")
    count = spectra.block_sum(np.ones(spectra.frequency.size))
    return RigFit(
        dynamics=dynamics,
        mass_identified=value is None,
        band=(float(spectra.frequency[0]), float(spectra.frequency[-1])),
        chi2=estimate.chi2,
        degrees_of_freedom=estimate.degrees_of_freedom,
        residual_frequency=spectra.block_sum(spectra.frequency) / count,
        residual_level=np.sqrt(spectra.block_sum(np.abs(estimate.residual) ** 2) / count),
        expected_level=np.sqrt(spectra.block_sum(estimate.floor) / count),
        coherence=spectra.coherence,
        coloured=estimate.coloured,
        left_out=fitted.left_out,
        live=live,
        notes=tuple(notes),
    )


def _mass(mass: float | tuple[float, float] | None) -> tuple[float | None, float]:
    """Split the mass into value and standard uncertainty."""
    if mass is None:
        return None, 0.0
    value, uncertainty = mass if isinstance(mass, tuple) else (mass, 0.0)
    if not 0 < value < np.inf or not 0 <= uncertainty < np.inf:
        raise ValueError(f"mass must be positive with an uncertainty of zero or more, not {value} and {uncertainty}")
    return value, uncertainty


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """What was fitted in the end, the mass that the response implies, and a mode that was seen and left out."""

    problem: Problem
    estimate: Estimate
    implied: float | None = None
    left_out: Mode | None = None


def _described(
    problem: Problem, modes: int | Literal["auto"], *, name: str, fixed_band: bool, looseness: float
) -> _Fitted:
    """Fit so that as many modes as are wanted describe the response, if that is possible.

    The record fixes the product of mass and gains. Where a mass given is so uncertain (`looseness`, relative, gains
    included) that it would blur the fit, or where the modes describe the response with another product only, natural
    frequencies, losses, shares and delay are taken from the shape of the response alone; the mass implied is returned
    too.
    """
    shapeless = replace(problem, mass=None)
    estimate, free = maximise(problem, name=name), None
    if modes != 1:
        # The modes are sought with the mass free, so that a gain that is off is not taken for one.
        free = maximise(shapeless, name=name, start=estimate.parameters) if problem.mass is not None else estimate
        free = _with_modes(shapeless, free, modes, name=name)
        if problem.mass is None:
            estimate = free
        elif free.further_modes:
            estimate = maximise(problem, name=name, start=free.parameters)
    if problem.mass is not None and (looseness or not estimate.adequate):
        free = free or maximise(shapeless, name=name)
        blurred = estimate.covariance[2, 2] + (looseness * estimate.sensitivity_to_mass[1]) ** 2
        if free.adequate and (not estimate.adequate or free.covariance[2, 2] < blurred):
            covariance = free.covariance.copy()
            covariance[0, :] = covariance[:, 0] = 0.0
            unmoved = np.zeros_like(free.sensitivity_to_mass)
            shaped = replace(free, mass=problem.mass, covariance=covariance, sensitivity_to_mass=unmoved)
            return _Fitted(problem, shaped, free.mass)
    if estimate.adequate:
        return _Fitted(problem, estimate)
    sought = modes == "auto" and 1 + len(estimate.further_modes) < SETTINGS.most_modes
    seen = None if sought else _left_out(shapeless, free or estimate, name=name)
    if not fixed_band and not estimate.further_modes:
        problem, estimate = _narrowed(problem, estimate, name=name)
    return _Fitted(problem, estimate, left_out=seen)


def _with_modes(problem: Problem, estimate: Estimate, modes: int | Literal["auto"], *, name: str) -> Estimate:
    """Fit so many modes, from an estimate with one.

    Raises
    ------
    FitError
        The record shows fewer.
    """
    most = (SETTINGS.most_modes if modes == "auto" else modes) - 1
    estimate = with_further_modes(problem, estimate, most=most, name=name)
    shown = 1 + len(estimate.further_modes)
    if modes != "auto" and shown < modes:
        raise FitError(
            f"{name}: {modes} modes are asked for, and the record shows {shown} above its noise; shake harder, for "
            "longer or over a wider band to see others"
        )
    return estimate


def _left_out(problem: Problem, estimate: Estimate, *, name: str) -> Mode | None:
    """A further mode that the record shows beside those that were fitted."""
    larger = one_more_mode(problem, estimate, name=name)
    if larger is None:
        return None
    known = [estimate.angular_frequency / (2 * np.pi)] + [mode.natural_frequency for mode in estimate.further_modes]
    return max(larger.further_modes, key=lambda mode: min(abs(np.log(mode.natural_frequency / f)) for f in known))


def _mass_notes(implied: float | None, given: float | None, looseness: float) -> list[str]:
    """Return the note that the response implies another mass than the one given."""
    if implied is None or given is None or abs(implied / given - 1) < max(SETTINGS.doubtful_mass, 3 * looseness):
        return []
    note = (
        f"the response implies a moving mass of {implied:.4g}, not {given:.4g}: the gain of the accelerometer or the "
        "balance is off, or the mass; stiffness and damping are those of the mass given"
    )
    return [note]


def _left_out_notes(mode: Mode | None, modes: int | Literal["auto"]) -> list[str]:
    """Return the name of the mode that the dynamics leave out."""
    if mode is None:
        return []
    advice = (
        f"no more than {SETTINGS.most_modes} are taken up"
        if modes == "auto"
        else f"{argument('modes', 'auto')} looks for it"
    )
    note = (
        f"a further mode at {mode.natural_frequency:.4g} Hz, {share_text(mode.share, 0.0)}, answers the ground "
        f"motion; it is not part of the dynamics, so forces near that frequency will be wrong ({advice})"
    )
    return [note]


def _narrowed(problem: Problem, estimate: Estimate, *, name: str) -> tuple[Problem, Estimate]:
    """Lower the top of the band until one mode describes the response, but not below a resonance that was seen.

    What other modes add at high frequency is not to bend the mode that is sought.
    """
    frequency = problem.spectra.frequency
    f0 = estimate.angular_frequency / (2 * np.pi)
    lowest = 1.25 * f0 if f0 < frequency[-1] else 4 * frequency[0]
    top = 0.85 * frequency[-1]
    while top > lowest:
        inside = frequency <= top
        narrow = replace(problem, spectra=problem.spectra.keep(inside))
        if narrow.spectra.blocks < SETTINGS.least_blocks:
            break
        candidate = maximise(narrow, name=name)
        if candidate.adequate:
            return narrow, candidate
        top *= 0.85
    return problem, estimate


def _dynamics(
    estimate: Estimate, problem: Problem, *, component: str, uncertainty: float, gain: float, name: str
) -> Dynamics:
    """Turn the estimate into mass, stiffness, damping, delay and modes, with what gains and mass leave open."""
    mass, w0 = estimate.mass, estimate.angular_frequency
    # What one mode does not describe is no noise: it enlarges the covariance by how much there is of it.
    covariance = estimate.covariance * (1.0 if estimate.adequate else estimate.correlation / estimate.blocks)
    if problem.mass is None:
        # An error of gain is an error of the mass found, and of nothing else.
        covariance[0, 0] += gain**2
    else:
        # The record fixes the product of mass and gain, so both shift the other parameters alike.
        shift = np.concatenate(([0.0], estimate.sensitivity_to_mass))
        covariance += gain**2 * np.outer(shift, shift)
        shift[0] = 1.0
        covariance += (uncertainty / mass) ** 2 * np.outer(shift, shift)
    stiffness, damping = mass * w0**2, mass * w0 * estimate.loss
    jacobian = np.zeros(covariance.shape)
    jacobian[:4, :4] = [
        [mass, 0.0, 0.0, 0.0],
        [stiffness, 2 * stiffness, 0.0, 0.0],
        [damping, damping, mass * w0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ]
    for number, mode in enumerate(estimate.further_modes):
        place = slice(4 + 3 * number, 7 + 3 * number)
        jacobian[place, place] = np.diag([mode.natural_frequency, 0.5, 1.0])
    dynamics = Dynamics(
        component=component,
        mass=mass,
        stiffness=stiffness,
        damping=damping,
        delay=estimate.delay,
        covariance=jacobian @ covariance @ jacobian.T,
        further_modes=estimate.further_modes,
    )
    f0, u = dynamics.natural_frequency, dynamics.uncertainty("natural_frequency")
    low, high = problem.spectra.frequency[0], problem.spectra.frequency[-1]
    if u > 0.1 * f0 or f0 > 0.5 * HIGHEST * high:
        raise FitError(
            f"{name}: the record does not carry the stiffness (natural frequency {f0:.4g} Hz give or take "
            f"{u:.2g} Hz from excitation between {low:.4g} and {high:.4g} Hz); "
            "excite nearer to the natural frequency"
        )
    return dynamics


def damping_note(dynamics: Dynamics) -> str:
    """Return the note that a record hardly tells the damping; empty where it does."""
    u = dynamics.uncertainty("damping")
    if u <= SETTINGS.doubtful_damping * dynamics.damping:
        return ""
    critical = 2 * dynamics.mass * 2 * np.pi * dynamics.natural_frequency
    return (
        f"the damping is hardly identifiable here ({damping_text(dynamics.damping, u, critical=critical)}); forces "
        "near the natural frequency inherit this uncertainty, slow forces do not"
    )


def _notes(
    dynamics: Dynamics, estimate: Estimate, *, problem: Problem, live: LiveCheck | None, component: str
) -> list[str]:
    """Return what is doubtful about the result."""
    spectra = problem.spectra
    notes = []
    if spectra.frequency[-1] < dynamics.natural_frequency or spectra.frequency[0] > dynamics.natural_frequency:
        notes.append(
            f"no excitation reaches the natural frequency {dynamics.natural_frequency:.4g} Hz (used: "
            f"{spectra.frequency[0]:.4g} to {spectra.frequency[-1]:.4g} Hz); stiffness and damping are extrapolated"
        )
    u = dynamics.uncertainty("damping")
    correlation = float(abs(dynamics.covariance[2, 3]) / max(u * dynamics.uncertainty("delay"), 1e-300))
    if hardly := damping_note(dynamics):
        notes.append(hardly)
    elif problem.delay is None and correlation > SETTINGS.doubtful_correlation:
        notes.append(
            f"damping and delay are hardly told apart here (correlation {correlation:.3f}), so the damping is hardly "
            "identifiable unless the delay is known; excite on both sides of the natural frequency"
        )
    power = spectra.block_sum(np.abs(spectra.load) ** 2)
    coherent = float(np.sum(spectra.coherence * power) / np.sum(power))
    if coherent < 0.8:
        notes.append(
            f"load and ground acceleration are poorly coherent ({coherent:.2f} of the load's power, over the band "
            "used); noise or another force on the live end enlarges the uncertainties"
        )
    if not estimate.adequate:
        count = 1 + len(estimate.further_modes)
        what = "one mode does not" if count == 1 else f"{count} modes do not"
        notes.append(
            f"{what} describe the response over the band used: what is left follows the ground motion "
            f"({estimate.correlation / estimate.blocks:.2g} times as much as chance); excite a narrower band about "
            "the natural frequency"
        )
    excess = estimate.chi2 / estimate.degrees_of_freedom
    if estimate.coloured and excess > 1.5:
        notes.append(
            f"the residuals exceed the noise of the channels ({excess:.3g} times in power): coloured noise or motion "
            "that the modes found do not describe; the weights and uncertainties come from the residual spectrum"
        )
    if live is not None and abs(live.gain - 1) > max(0.02, 3 * live.u_gain):
        notes.append(
            f"the live accelerometer reads {live.gain:.3f} times what the {component} readings and the mass imply; "
            "its gain, the balance's, or the mass is off"
        )
    return notes
