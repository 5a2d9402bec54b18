"""Dynamics of either kind as the commands use them: components each for itself, or components that ring together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.coupled_force import noise_of_coupled, reconstruct_coupled
from aerobalance.estimation.force import Method, noise_of, reconstruct, without_hum
from aerobalance.estimation.record import ForceEstimate
from aerobalance.estimation.spectra.line_noise import Hum
from aerobalance.estimation.spectra.noise_spectrum import NoiseSpectrum
from aerobalance.io.coupled_file import read_any_dynamics
from aerobalance.motion.single_axis import GroundMotion
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY
from aerobalance.recording.gravity import gravity_share
from aerobalance.recording.recording import Recording
from aerobalance.uncertainty.monte_carlo import MonteCarlo, monte_carlo, monte_carlo_of_coupled
from aerobalance.validation.coupled_model_check import misfits_of_coupled
from aerobalance.validation.model_check import misfit_of
from aerobalance.validation.unmeasured_rotation import turning_by_angles

DEFAULT_SEED: Final = 1
"""Seed of Monte Carlo where none is given, so that the same inputs give the same result."""


class Settings(NamedTuple):
    """How the force is worked out.

    Attributes
    ----------
    method, bandwidth, hum
        As `aerobalance.estimation.force.reconstruct` takes them.
    gravity, gravity_uncertainty
        Local acceleration of gravity and its standard uncertainty [m/s^2].
    """

    method: Method = "smoother"
    bandwidth: float | None = None
    gravity: float = STANDARD_GRAVITY
    gravity_uncertainty: float = 0.0
    hum: Hum = "mains"


class Check(NamedTuple):
    """A Monte Carlo check that is wanted.

    Attributes
    ----------
    draws
        Number of draws.
    seed
        Seed that they come from.
    """

    draws: int
    seed: int = DEFAULT_SEED


class Known(Protocol):
    """What a command asks of dynamics of either kind."""

    @property
    def components(self) -> tuple[str, ...]:
        """Components that the dynamics are of."""

    def names_in(self, recording: Recording) -> list[str]:
        """Components of a recording that a force can be worked out for."""

    def weight(self, name: str, *, pitch: Array, roll: Array, gravity: float) -> Array:
        """Weight of the moving mass along a component at given attitudes, shape (n,) [N, N*m]."""

    def ringing(self, names: Sequence[str], frequency: Array) -> NDArray[np.complex128]:
        """Force over load felt, less 1, at frequencies of shape (m,) [Hz]; shape (m, n, n) for n names."""

    def noises(self, calm: Recording, settings: Settings, *, run: Recording) -> dict[str, NoiseSpectrum]:
        """Spectra of the noise of a run, by component, from a record of noise alone."""

    def forces(
        self, recording: Recording, settings: Settings, *, noises: Mapping[str, NoiseSpectrum]
    ) -> dict[str, ForceEstimate]:
        """Forces applied, by component."""

    def checked(
        self, recording: Recording, estimates: Mapping[str, ForceEstimate], settings: Settings, *, check: Check
    ) -> dict[str, MonteCarlo]:
        """The uncertainty of every component checked by Monte Carlo."""

    def doubts(self, recording: Recording, estimates: Mapping[str, ForceEstimate]) -> list[str]:
        """What a recording says against the dynamics."""


@dataclass(frozen=True, slots=True)
class Separate:
    """Components each for itself.

    Attributes
    ----------
    parts
        Dynamics by component.
    """

    parts: Mapping[str, Dynamics]

    @property
    def components(self) -> tuple[str, ...]:
        """Components whose dynamics are known."""
        return tuple(self.parts)

    def names_in(self, recording: Recording) -> list[str]:
        """Components of the recording whose dynamics are known."""
        return [name for name in self.parts if name in recording]

    def weight(self, name: str, *, pitch: Array, roll: Array, gravity: float) -> Array:
        """Weight of the component's own moving mass."""
        return self.parts[name].mass * gravity * gravity_share(name, pitch=pitch, roll=roll)

    def ringing(self, names: Sequence[str], frequency: Array) -> NDArray[np.complex128]:
        """Every component by itself."""
        found = np.zeros((frequency.size, len(names), len(names)), dtype=np.complex128)
        for place, name in enumerate(names):
            found[:, place, place] = 1 / self.parts[name].response(frequency) - 1
        return found

    def noises(self, calm: Recording, settings: Settings, *, run: Recording) -> dict[str, NoiseSpectrum]:
        """Spectra of the noise of the components in the record; the run has no part in them."""
        return {
            name: noise_of(
                calm, self.parts[name], gravity=settings.gravity, gravity_uncertainty=settings.gravity_uncertainty
            )
            for name in self.names_in(calm)
        }

    def forces(
        self, recording: Recording, settings: Settings, *, noises: Mapping[str, NoiseSpectrum]
    ) -> dict[str, ForceEstimate]:
        """One component after the other."""
        return {
            name: reconstruct(recording, self.parts[name], noise=noises.get(name), **settings._asdict())
            for name in self.names_in(recording)
        }

    def checked(
        self, recording: Recording, estimates: Mapping[str, ForceEstimate], settings: Settings, *, check: Check
    ) -> dict[str, MonteCarlo]:
        """The check of one component after the other."""
        gravity = {"gravity": settings.gravity, "gravity_uncertainty": settings.gravity_uncertainty}
        return {
            name: monte_carlo(
                recording,
                self.parts[name],
                estimate,
                motion=GroundMotion.of(recording, name, **gravity),
                draws=check.draws,
                seed=check.seed,
                method=settings.method,
                bandwidth=settings.bandwidth,
            )
            for name, estimate in estimates.items()
        }

    def doubts(self, recording: Recording, estimates: Mapping[str, ForceEstimate]) -> list[str]:
        """Modes that the dynamics lack, and frequencies and dampings that have changed."""
        found = []
        for name, estimate in estimates.items():
            quiet = without_hum(recording, estimate)
            misfit = misfit_of(quiet, self.parts[name], noise=estimate.noise, steps=estimate.steps)
            found += misfit.sentences(self.parts[name])
        return found


@dataclass(frozen=True, slots=True)
class Coupled:
    """Components that ring together.

    Attributes
    ----------
    dynamics
        Their dynamics.
    """

    dynamics: CoupledDynamics

    @property
    def components(self) -> tuple[str, ...]:
        """Components that ring together."""
        return self.dynamics.components

    def names_in(self, recording: Recording) -> list[str]:
        """All components, or none."""
        names = list(self.dynamics.components)
        return names if any(name in recording for name in names) else []

    def weight(self, name: str, *, pitch: Array, roll: Array, gravity: float) -> Array:
        """Weight of the common moving mass along a component."""
        if self.dynamics.mass is None:
            return np.zeros_like(pitch)
        return self.dynamics.mass.weight(pitch, roll, gravity=gravity)[:, COMPONENTS.index(name)]

    def ringing(self, names: Sequence[str], frequency: Array) -> NDArray[np.complex128]:
        """D s + A s^2, in the order of the names, which are those of all components."""
        order = [self.components.index(name) for name in names]
        ringing = self.dynamics.inverse_response(frequency) - np.eye(len(self.components))
        return np.asarray(ringing[:, order][:, :, order])

    def noises(self, calm: Recording, settings: Settings, *, run: Recording) -> dict[str, NoiseSpectrum]:
        """Spectra of the noise of the components as they are taken apart in the run."""
        return noise_of_coupled(
            calm,
            self.dynamics,
            run=run,
            gravity=settings.gravity,
            gravity_uncertainty=settings.gravity_uncertainty,
        )

    def forces(
        self, recording: Recording, settings: Settings, *, noises: Mapping[str, NoiseSpectrum]
    ) -> dict[str, ForceEstimate]:
        """All components at once."""
        return reconstruct_coupled(recording, self.dynamics, noise=noises, **settings._asdict())

    def checked(
        self, recording: Recording, estimates: Mapping[str, ForceEstimate], settings: Settings, *, check: Check
    ) -> dict[str, MonteCarlo]:
        """The check of every component."""
        return monte_carlo_of_coupled(
            recording,
            self.dynamics,
            estimates,
            draws=check.draws,
            seed=check.seed,
            gravity=settings.gravity,
            gravity_uncertainty=settings.gravity_uncertainty,
            method=settings.method,
            bandwidth=settings.bandwidth,
        )

    def doubts(self, recording: Recording, estimates: Mapping[str, ForceEstimate]) -> list[str]:
        """Modes of the record that the dynamics do not have, or have elsewhere, and turning that only angles show."""
        return [
            *misfits_of_coupled(recording, self.dynamics, estimates),
            *turning_by_angles(recording, self.dynamics, estimates),
        ]


def read_known(path: Path) -> Separate | Coupled:
    """Read a dynamics.json of either kind.

    Raises
    ------
    ReadError
        The file is no such JSON, or its numbers are not physical.
    """
    found = read_any_dynamics(path)
    return Coupled(found) if isinstance(found, CoupledDynamics) else Separate(found)
