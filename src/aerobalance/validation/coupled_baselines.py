"""The other ways from balance load to force, on coupled components.

What knows one component is given the best of one component: its own reading, with what gravity and the ground's motion
put on the balance taken off by the coupled dynamics, and its own response to its own load with all modes in it. The
direct inverses, and the smoother, are run with the matrices and, to show what coupling costs, with their diagonals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.modal import ModalModel
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.estimation.direct import band_limited, central_differences
from aerobalance.estimation.force import estimate_force
from aerobalance.estimation.force_smoother import SmootherResult
from aerobalance.estimation.prior import fit_prior
from aerobalance.estimation.record import BalanceRecord, ComponentRecord
from aerobalance.estimation.result import ComponentForce
from aerobalance.estimation.steps import columns_of
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import MOMENTS
from aerobalance.recording.errors import FitError
from aerobalance.recording.progress import PROGRESS
from aerobalance.recording.recording import Recording
from aerobalance.recording.sensors import angles_of
from aerobalance.validation.baselines import (
    THIS,
    ZERO_PHASE,
    BaselineEstimate,
    BaselineSettings,
    Estimator,
    accelerometer_correction,
    corner_frequency,
    correction_factor,
    estimates,
    factor_and_phase,
    fir_deconvolution,
    low_pass,
    notch,
    without_gaps,
)
from aerobalance.validation.baselines import TUNED as ALONE_TUNED
from aerobalance.validation.scores import Truth

TUNED: Final = (
    *(name for name in ALONE_TUNED if name != "band-limited inverse"),
    "band-limited inverse, diagonal",
    "band-limited inverse, coupled",
)
"""Baseline methods with one tuning number."""

ONE_COMPONENT: Final = "knows one component only: what the others' forces ring in it stays"
"""Note on a method that takes no other reading."""


@dataclass(frozen=True, slots=True, eq=False)
class _Component:
    """One component of a record, with what its baseline methods need.

    Attributes
    ----------
    record
        The whole record.
    filled
        Its readings without gaps, shape (samples, n).
    own
        The program's own estimates of all components.
    place
        Which component.
    """

    record: BalanceRecord
    filled: Array
    own: Mapping[str, ComponentForce]
    place: int

    @property
    def name(self) -> str:
        return self.record.dynamics.components[self.place]

    @property
    def quiet(self) -> Recording:
        """Its own reading less what gravity and the ground's motion put on the balance, and nothing else."""
        values = self.record.without_ground(self.filled, on_clock_of=self.place)[:, self.place]
        own = self.record.channels[self.place]
        channel = Channel(own.name, values, own.unit, noise=own.noise)
        return replace(self.record.recording, channels={own.name: channel})

    @property
    def diagonal(self) -> CoupledDynamics:
        """The component with the diagonals of the matrices."""
        damping, inertia = (part[[self.place]][:, [self.place]] for part in self.record.dynamics.quadratic)
        return CoupledDynamics((self.name,), inertia, np.maximum(damping, 0.0))

    def _alone(self, recording: Recording, *, with_gaps: bool = False) -> ComponentRecord:
        """The component by the diagonals, made ready; what the record says against them is not asked."""
        given = recording if with_gaps else without_gaps(recording, self.name)
        return CoupledRecord.of(given, self.diagonal).component_record(self.name)

    def baselines(self) -> dict[str, Estimator]:
        """All of them by name."""
        one: dict[str, Estimator] = {
            "low-pass": low_pass,
            "notch and low-pass": notch,
            "accelerometer correction": self.by_accelerometer,
            "correction factor": correction_factor,
            "correction factor and phase": factor_and_phase,
            "FIR deconvolution": fir_deconvolution,
        }
        return {
            "raw reading": self.raw,
            **{name: _noted(baseline) for name, baseline in one.items()},
            "central differences, diagonal": self.differences_by_diagonal,
            "central differences, coupled": self.differences,
            "band-limited inverse, diagonal": self.limited_by_diagonal,
            "band-limited inverse, coupled": self.limited,
            f"{THIS}, diagonal": self.smoothed_by_diagonal,
            THIS: self.estimator,
        }

    def raw(self, recording: Recording, dynamics: ModalModel, settings: BaselineSettings) -> BaselineEstimate:
        """Take the balance load for the force, less the weight where the attitude and the mass are known."""
        load, whole, model = self.filled[:, self.place], self.record.recording, self.record.dynamics
        if not model.moved_by.any() or "pitch" not in whole:
            return BaselineEstimate("raw reading", load, "as read", "no delay")
        pitch, roll = angles_of(whole, delay=self.record.channels[self.place].delay)
        weight = model.weight(self.name, pitch=pitch, roll=roll, gravity=settings.gravity)
        return BaselineEstimate("raw reading", load - weight, "as read, less the weight", "no delay")

    def by_accelerometer(
        self, recording: Recording, dynamics: ModalModel, settings: BaselineSettings
    ) -> BaselineEstimate:
        """The inertia of the live end by its own accelerometer, which is that of a force."""
        mass = self.record.dynamics.mass
        if self.name in MOMENTS:
            raise FitError("has no meaning for a moment: an accelerometer does not measure how the live end turns")
        if mass is None:
            raise FitError("the dynamics hold no mass")
        balance = Dynamics(
            self.name, mass=mass.mass, stiffness=mass.mass / float(self.diagonal.inertia[0, 0]), damping=0.0
        )
        return accelerometer_correction(self.record.recording, balance, settings)

    def differences_by_diagonal(
        self, recording: Recording, dynamics: ModalModel, settings: BaselineSettings
    ) -> BaselineEstimate:
        """Eq. (17) of [Gorbushin2020]_ with the paper's derivatives and the diagonals of the matrices."""
        found = central_differences(self._alone(recording))
        note = f"no delay; first and last sample poor; {ONE_COMPONENT}"
        return BaselineEstimate("central differences, diagonal", found.values, found.method, note)

    def limited_by_diagonal(
        self, recording: Recording, dynamics: ModalModel, settings: BaselineSettings
    ) -> BaselineEstimate:
        """The inverse by the diagonals limited to a band, customarily twice the component's natural frequency."""
        bandwidth = corner_frequency(recording, settings, 2 * self.diagonal.modes[0].natural_frequency)
        found = band_limited(self._alone(recording), bandwidth)
        note = f"{ZERO_PHASE}; {ONE_COMPONENT}"
        return BaselineEstimate("band-limited inverse, diagonal", found.values, found.method, note, tuning=bandwidth)

    def differences(self, recording: Recording, dynamics: ModalModel, settings: BaselineSettings) -> BaselineEstimate:
        """X + D X' + A X'' with three-point central differences of all readings."""
        model, (damping, inertia) = self.record.dynamics, self.record.dynamics.quadratic
        felt, interval = self.record.without_ground(self.filled, on_clock_of=self.place), self.record.interval
        rate = np.gradient(felt, interval, axis=0)
        acceleration = np.zeros_like(felt)
        acceleration[1:-1] = np.diff(felt, 2, axis=0) / interval**2
        further = model.poles.size // 2 - len(model.components)
        left = f", {further} further mode(s) left out" if further else ""
        return BaselineEstimate(
            "central differences, coupled",
            felt[:, self.place] + rate @ damping[self.place] + acceleration @ inertia[self.place],
            f"X + D X' + A X'', three-point central differences{left}",
            "no delay; first and last sample poor",
        )

    def limited(self, recording: Recording, dynamics: ModalModel, settings: BaselineSettings) -> BaselineEstimate:
        """The inverse by the matrices limited to a band, customarily twice the highest natural frequency."""
        customary = 2 * max(mode.natural_frequency for mode in self.record.dynamics.modes)
        bandwidth = corner_frequency(recording, settings, customary)
        ready = self.record.component_record(self.name, self.filled)
        ready = replace(ready, recording=without_gaps(ready.recording, self.name))
        found = band_limited(ready, bandwidth)
        return BaselineEstimate(
            "band-limited inverse, coupled", found.values, found.method, ZERO_PHASE, tuning=bandwidth
        )

    def smoothed_by_diagonal(
        self, recording: Recording, dynamics: ModalModel, settings: BaselineSettings
    ) -> BaselineEstimate:
        """The smoother with the diagonals of the matrices; what they leave ringing would be taken for steps."""
        reading = self._alone(recording, with_gaps=True).reading()
        learned = fit_prior(reading, columns=columns_of([], reading))
        values = SmootherResult.of(reading, learned=learned, steps=()).force
        words = f"smoother: {learned.spectrum}; no steps looked for: what the diagonal leaves ringing looks like many"
        return BaselineEstimate(f"{THIS}, diagonal", values, words, f"no delay; {ONE_COMPONENT}")

    def estimator(self, recording: Recording, dynamics: ModalModel, settings: BaselineSettings) -> BaselineEstimate:
        """The program's own estimate."""
        found = self.own[self.name]
        return BaselineEstimate(THIS, found.values, found.method, "no delay; every sample has its uncertainty")


def estimates_of_coupled(
    recording: Recording,
    dynamics: CoupledDynamics,
    *,
    components: tuple[str, ...],
    settings: BaselineSettings | None = None,
    truths: Mapping[str, Truth] | None = None,
) -> dict[str, list[BaselineEstimate]]:
    """Run every baseline method on some components of one record; with truths, the tunable ones also at their best.

    Parameters
    ----------
    recording
        Balance loads of all components, and what else is recorded.
    dynamics
        The coupled components.
    components
        Which of them are wanted.
    settings
        Gravity, and a measured response where there is one.
    truths
        What was applied, by component.

    Raises
    ------
    FitError
        A component that the others ring with is not in the recording, or it is too short.
    """
    settings = replace(settings or BaselineSettings(), still=True)
    # what is compared are values: without a covariance no method is run again to learn its uncertainty
    exact = dynamics.exact
    own = estimate_force(replace(recording, from_outputs=False), exact, gravity=settings.gravity)
    record, filled = own.record, own.filled
    found = {}
    for name in PROGRESS.each(components, "component"):
        part = _Component(record, filled, own, exact.components.index(name))
        found[name] = estimates(
            part.quiet,
            exact.own_response(name),
            settings=settings,
            truth=(truths or {}).get(name),
            baselines=part.baselines(),
            tuned=TUNED,
        )
    return found


def _noted(baseline: Estimator) -> Estimator:
    """A baseline method that says that it knows one component only."""

    def run(recording: Recording, dynamics: ModalModel, settings: BaselineSettings) -> BaselineEstimate:
        found = baseline(recording, dynamics, settings)
        return replace(found, note=f"{found.note}; {ONE_COMPONENT}")

    return run
