"""What recordings tell about coupled components, however they were excited, and what is doubtful about it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypedDict

import numpy as np

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.modal import Mode
from aerobalance.identification.coupled.combinations import combination_of, combination_text, pairs
from aerobalance.identification.coupled.free_response import Complex, FreeMotion
from aerobalance.identification.coupled.internal_coordinates import static_contributions
from aerobalance.identification.coupled.modes import ModeTable
from aerobalance.identification.force_error import error_of, force_weights, highest_of
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit
from aerobalance.recording.wording import percent_text

FORCE_ERROR_SAID: Final = 10.0
"""Force error, over half of range, beyond which only that it is larger is said."""

APPLIED: Final = 0.1
"""Rms of the load for which the force error is predicted, over half of range."""

TOO_LARGE: Final = 1e-3
"""Predicted force error over half of range above which a further release is asked for."""


@dataclass(frozen=True, slots=True, eq=False)
class CoupledResult:
    """What recordings tell about coupled components, from releases or from shaking.

    Attributes
    ----------
    dynamics
        A and D with their covariance, and the rigid mass where it is known.
    modes, u_natural_frequency, u_damping_ratio
        Modes, the slowest first, and their standard uncertainties, shape (modes,) [Hz] and [1].
    mode_shapes
        Balance loads in every mode over half of range, rows, the largest of a row 1; shape (modes, n).
    combinations
        Combination of loads, each over half of range, that sets off a mode and no other, rows; shape (modes, n).
    half_range, half_range_given
        Half of range by component, shape (n,) [N, N*m], and whether it was given; otherwise the largest change of
        load in the recordings stands for it.
    residual_deviation
        Standard deviation of the residuals, shape (n,) [N, N*m].
    reduced_chi2
        Variance of the residuals over that of the noise as given for the channel or judged from it, shape (n,).
    colour
        Power of the residuals near the modes over that of white noise, 1 where they pass as white, shape (n,);
        the uncertainties contain it.
    degrees_of_freedom
        Readings used less parameters.
    applied, band
        Load for which the force error is predicted: rms by component, shape (n,) [N, N*m], white between two
        frequencies [Hz].
    force_error
        Rms error of the force under that load from the uncertainty of A and D alone, shape (n,) [N, N*m].
    notes
        What a reader of the result should know, each a sentence.
    """

    dynamics: CoupledDynamics
    modes: tuple[Mode, ...]
    u_natural_frequency: Array
    u_damping_ratio: Array
    mode_shapes: Complex
    combinations: Array
    half_range: Array
    half_range_given: bool
    residual_deviation: Array
    reduced_chi2: Array
    colour: Array
    degrees_of_freedom: int
    applied: Array
    band: tuple[float, float]
    force_error: Array
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        told = zip(self.modes, self.u_natural_frequency, self.u_damping_ratio, strict=True)
        rows = [one.told(u_frequency, u_ratio) for one, u_frequency, u_ratio in told]
        names = self.dynamics.components
        left = ", ".join(
            f"{name} {error:.2g} {si_unit(name)}" for name, error in zip(names, self.force_error, strict=True)
        )
        return "\n  ".join(
            [f"identification of {', '.join(names)}", *rows, f"force error that it leaves: {left}", *self.notes]
        )

    @property
    def static_contributions(self) -> Array:
        """Modal contribution of every mode to the balance loads at rest, shape (modes,) [1]."""
        return static_contributions(self.dynamics.modal_form)

    @property
    def further(self) -> tuple[int, ...]:
        """Places of the modes of the model or sting, of least static contribution, one per internal coordinate."""
        return tuple(sorted(int(place) for place in np.argsort(self.static_contributions)[: self.dynamics.internal]))


class CommonParts(TypedDict):
    """The fields of `CoupledResult` but its notes, for the results of releases, taps and shaking to be made of."""

    dynamics: CoupledDynamics
    modes: tuple[Mode, ...]
    u_natural_frequency: Array
    u_damping_ratio: Array
    mode_shapes: Complex
    combinations: Array
    half_range: Array
    half_range_given: bool
    residual_deviation: Array
    reduced_chi2: Array
    colour: Array
    degrees_of_freedom: int
    applied: Array
    band: tuple[float, float]
    force_error: Array


def common_parts(
    dynamics: CoupledDynamics,
    motion: FreeMotion,
    *,
    half_range: Array,
    half_range_given: bool,
    residual_deviation: Array,
    reduced_chi2: Array,
    colour: Array,
    degrees_of_freedom: int,
) -> CommonParts:
    """What every result holds, with modes, their combinations and the force error of the dynamics.

    Parameters
    ----------
    dynamics
        What was found.
    motion
        Its free motion, loads over half of range.
    half_range, half_range_given, residual_deviation, reduced_chi2, colour, degrees_of_freedom
        As `CoupledResult` has them.
    """
    table = ModeTable.of(dynamics, sizes=half_range)
    applied = APPLIED * half_range
    return CommonParts(
        dynamics=dynamics,
        modes=table.modes,
        u_natural_frequency=table.u_natural_frequency,
        u_damping_ratio=table.u_damping_ratio,
        mode_shapes=table.shapes,
        combinations=np.array([combination_of(motion, mode) for mode in range(len(pairs(motion)[0]))]),
        half_range=half_range,
        half_range_given=half_range_given,
        residual_deviation=residual_deviation,
        reduced_chi2=reduced_chi2,
        colour=colour,
        degrees_of_freedom=degrees_of_freedom,
        applied=applied,
        band=(0.0, highest_of(dynamics)),
        force_error=error_of(dynamics.covariance, force_weights(dynamics, sizes=applied)),
    )


def force_error_warnings(found: CoupledResult, *, left_by: str, energy: Array, remedy: str, after: float) -> list[str]:
    """Return the note that the force error that the recordings leave is large, and what would bring it down.

    Parameters
    ----------
    found
        What was found.
    left_by
        The recordings in words.
    energy
        How strongly each mode was excited, shape (modes,).
    remedy, after
        What to add, and the largest force error that it would leave, over half of range.
    """
    names = found.dynamics.components
    relative = found.force_error / found.half_range
    if relative.max() <= TOO_LARGE:
        return []
    range_text = "half of range" if found.half_range_given else "the largest load in the recordings"
    large = ", ".join(
        f"{name} {error:.2g} {si_unit(name)} ({percent_text(part, most=FORCE_ERROR_SAID)})"
        for name, error, part in zip(names, found.force_error, relative, strict=True)
        if part > TOO_LARGE
    )
    weak = int(np.argmin(energy))
    text = (
        f"the {left_by} leave a force error of more than {100 * TOO_LARGE:g} % of {range_text} under a broadband "
        f"load of {100 * APPLIED:g} % rms to {found.band[1]:.4g} Hz: {large}; least excited is the mode at "
        f"{found.modes[weak].natural_frequency:.4g} Hz (by {combination_text(found.combinations[weak], names)}); "
        f"{remedy} brings it down to {percent_text(after, most=FORCE_ERROR_SAID)}"
    )
    return [text]


def colour_warnings(found: CoupledResult) -> list[str]:
    """Return the note that the residuals near the modes are more than noise."""
    names = found.dynamics.components
    coloured = [f"{name} ({value:.1f})" for name, value in zip(names, found.colour, strict=True) if value > 2]
    if not coloured:
        return []
    text = (
        f"the residuals near the modes are stronger than white noise in {', '.join(coloured)} (power over white); "
        "something else moves too, and the uncertainties are enlarged accordingly"
    )
    return [text]
