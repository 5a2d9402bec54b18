"""The estimator and the baseline methods side by side on one record, of one component or of several."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from aerobalance.balance.calibration.fit import Calibration
from aerobalance.balance.loads import Loads
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.reduction import reduction_of
from aerobalance.balance.zeros import Zero
from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.independent import AnyDynamics, dynamics_of
from aerobalance.dynamics.modal import ModalModel
from aerobalance.recording.blas_threads import one_blas_thread
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.errors import FitError, argument, check_recording
from aerobalance.recording.progress import PROGRESS
from aerobalance.recording.recording import Recording
from aerobalance.validation.baselines import BaselineEstimate, BaselineSettings, estimates
from aerobalance.validation.coupled_baselines import estimates_of_coupled
from aerobalance.validation.fir_inverse import response_of_record
from aerobalance.validation.scores import Truth, truth_on_clock


@dataclass(frozen=True, slots=True, eq=False)
class Comparison(Mapping[str, Sequence[BaselineEstimate]]):
    """Estimates of all methods, by component; the program's own is the last of each.

    Attributes
    ----------
    estimates
        What each method gives, by component. With a truth, a method with a tuning number stands twice: with its
        customary setting, and with that of the least rms deviation from the truth.
    recording
        The balance loads that they were worked out from.
    dynamics
        The dynamics.
    responses
        Response of each component to its own load: every mode with its share of a steady load.
    truths
        What was applied, by component, where it is known.
    loads
        The loads with their matrix, where they come from gauge outputs.
    """

    estimates: Mapping[str, Sequence[BaselineEstimate]]
    recording: Recording
    dynamics: BalanceDynamics
    responses: Mapping[str, ModalModel]
    truths: Mapping[str, Truth]
    loads: Loads | None = None

    def __repr__(self) -> str:
        rows = [
            f"{name}: {one.name} ({one.lacking or one.settings}{', tuned on the truth' if one.oracle else ''})"
            for name, ones in self.estimates.items()
            for one in ones
        ]
        return "\n  ".join([f"comparison on {self.recording.name}", *rows])

    def __getitem__(self, component: str) -> Sequence[BaselineEstimate]:
        return self.estimates[component]

    def __iter__(self) -> Iterator[str]:
        return iter(self.estimates)

    def __len__(self) -> int:
        return len(self.estimates)


@one_blas_thread()
def compare(
    run: Recording | Loads,
    dynamics: AnyDynamics,
    *,
    truth: Recording | None = None,
    components: Sequence[str] | None = None,
    step: Recording | Loads | None = None,
    balance: BalanceMatrix | Calibration | None = None,
    zero: Zero | None = None,
    gravity: float = STANDARD_GRAVITY,
) -> Comparison:
    """Forces [N, N*m] by the estimator and by every baseline method, from one record.

    Parameters
    ----------
    run
        Balance loads, and what else was recorded; or with `balance` gauge outputs.
    dynamics
        Dynamics of one component or of several, coupled or not.
    truth
        Force applied, where it is known, on the clock of the run.
    components
        Components that are compared; all that the dynamics and the run have where left out.
    step
        A record of a step of one component, from which the deconvolution takes its response; of loads or outputs as
        `run` is. Only one component can be compared then.
    balance, zero
        Where gauge outputs are given: the balance matrix or its calibration, and the zero that they count from.
    gravity
        Local acceleration of gravity [m/s^2].

    Raises
    ------
    FitError
        The run or the dynamics lack a component, or the truth is not on the clock of the run.
    ValueError
        A step is given for several components.
    """
    check_recording(run)
    model = dynamics_of(dynamics)

    made_ready = reduction_of(balance, zero=zero, model=model, gravity=gravity)
    ready = made_ready(run)
    if isinstance(ready, Loads):
        ready.check_ready()
    recording = ready.recording if isinstance(ready, Loads) else ready
    names = _names(recording, model, components)
    if step is not None and len(names) > 1:
        raise ValueError(
            f"{argument('step')} is a step of one component: name that one of {', '.join(names)} with "
            f"{argument('components')}"
        )
    responses = {name: model.own_response(name) for name in names}
    lowest = min(response.natural_frequency for response in responses.values())
    truths = {}
    if truth is not None:
        for name in names:
            values = truth_on_clock(recording, truth, name)
            truths[name] = Truth.of(values, rate=recording.rate, natural_frequency=lowest)
    response = None
    if step is not None:
        stepped = made_ready(step)
        stepped = stepped.recording if isinstance(stepped, Loads) else stepped
        response = response_of_record(stepped, names[0], natural_frequency=lowest, rate=recording.rate)
    settings = BaselineSettings(gravity=gravity, response=response)
    found: dict[str, Sequence[BaselineEstimate]] = {}
    if isinstance(model, CoupledDynamics):
        found |= estimates_of_coupled(recording, model, components=names, settings=settings, truths=truths)
    else:
        alone = PROGRESS.each(names, "component")
        found |= {
            name: estimates(recording, responses[name], settings=settings, truth=truths.get(name)) for name in alone
        }
    return Comparison(found, recording, model, responses, truths, ready if isinstance(ready, Loads) else None)


def _names(recording: Recording, model: BalanceDynamics, components: Sequence[str] | None) -> tuple[str, ...]:
    """Components that are compared."""
    lacking = [name for name in components or () if name not in model.components]
    if lacking:
        raise FitError(f"the dynamics have no {lacking[0]}; they have {', '.join(model.components)}")
    if components is None:
        components = model.estimable(recording.channels) or model.components
    if not components:
        raise FitError(f"no component to compare: name some of {', '.join(model.components)}")
    for name in components:
        recording.channel(name)  # whose error tells what the recording has
    return tuple(components)
