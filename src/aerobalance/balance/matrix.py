r"""Balance matrix: balance loads [N, N*m] from gauge outputs [mV/V], Eq. (2) of [Gorbushin2020]_.

Eq. (2) and both ways of AIAA R-091 are one thing here: polynomials of terms such as N1, \|N1\|, N1*N2. In the
iterative way they give the outputs from the loads, and the loads are found by iteration; in the non-iterative way they
give the loads from the outputs. Inside, loads are over capacity and outputs over the output at capacity, so that
coefficients are of size one and can be compared.

References
----------
.. [Gorbushin2020] A. R. Gorbushin, A. A. Bolshakova, "Unsteady axial force measurement by the strain gauge balance",
   Measurement 152 (2020) 107381. https://doi.org/10.1016/j.measurement.2019.107381
.. [R091] AIAA R-091, "Calibration and use of internal strain-gage balances with application to wind tunnel testing".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from aerobalance.balance import _term_kernels as kernels
from aerobalance.balance.inversion import inverted
from aerobalance.balance.load_formats import BalanceType, Geometry, to_direct
from aerobalance.balance.terms import KINDS, MODELS, Term, codes, linear_part
from aerobalance.recording.channel import Array

Way = Literal["iterative", "non-iterative"]

CHUNK: Final = 1 << 15
"""Samples worked on at a time where whole design matrices are needed."""


@dataclass(frozen=True, slots=True)
class TemperatureEffect:
    """Change of zero [mV/V per K] and sensitivity [1/K] of one bridge with temperature.

    Attributes
    ----------
    reference
        Temperature of the matrix [degC].
    zero, u_zero
        Change of the zero by temperature, and its standard uncertainty [mV/V/K].
    sensitivity, u_sensitivity
        Relative change of the sensitivity by temperature, and its standard uncertainty [1/K].
    """

    reference: float
    zero: float
    u_zero: float
    sensitivity: float
    u_sensitivity: float


class Solution(NamedTuple):
    """Loads from gauge outputs.

    Attributes
    ----------
    loads
        Shape (n, c) [N, N*m]; NaN where an output is missing or no load was found.
    steps
        Iterations of every sample, shape (n,); 0 where no load was found.
    """

    loads: Array
    steps: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class BalanceMatrix:
    """Balance matrix with its covariance: c components, c bridges, t terms.

    Attributes
    ----------
    components, gauges
        Names of the loads and of the bridges.
    way
        ``"iterative"``: outputs as polynomials of the loads; ``"non-iterative"``: loads as polynomials of the outputs.
    terms
        The t terms; a component that lacks one has zero there.
    coefficients
        Shape (t, c), for normalised loads and outputs: over `load_scale` and `output_scale` [1].
    load_scale
        Capacities, shape (c,) [N, N*m].
    output_scale
        Outputs at capacity, positive, shape (c,) [mV/V].
    covariance
        Covariance of each column of `coefficients` [1], shape (c, t, t). A term left out for want of significance has
        the coefficient zero and yet an uncertainty.
    residual_deviation
        Standard deviation of the calibration's residuals, normalised, shape (c,) [1].
    residual_correlation
        Correlation between the residuals of the components, shape (c, c) [1].
    degrees_of_freedom
        Of the residuals of each component, shape (c,).
    calibrated
        Least and largest load calibrated, tares included, shape (2, c) [N, N*m].
    natural_zero
        Outputs of the weightless balance, shape (c,) [mV/V]; None where not known.
    moments
        True for the components that are moments, shape (c,).
    balance_type, geometry
        Which loads the gauges measure, and where the gauges are.
    temperature
        Temperature effects by component, where known.
    reading_noise
        Standard deviation of one reading of the calibration [mV/V], where known, one for all bridges or of shape (c,):
        the residuals hold it, but no load of a recording, which has noise of its own.
    """

    components: tuple[str, ...]
    gauges: tuple[str, ...]
    way: Way
    terms: tuple[Term, ...]
    coefficients: Array
    load_scale: Array
    output_scale: Array
    covariance: Array
    residual_deviation: Array
    residual_correlation: Array
    degrees_of_freedom: NDArray[np.intp]
    calibrated: Array
    natural_zero: Array | None
    moments: NDArray[np.bool]
    balance_type: BalanceType = "unknown"
    geometry: Geometry | None = None
    temperature: Mapping[str, TemperatureEffect] = field(default_factory=dict)
    reading_noise: float | Array = 0.0

    def __post_init__(self) -> None:
        c, t = len(self.components), len(self.terms)
        shapes = {
            "coefficients": (t, c),
            "load_scale": (c,),
            "output_scale": (c,),
            "covariance": (c, t, t),
            "residual_deviation": (c,),
            "residual_correlation": (c, c),
            "degrees_of_freedom": (c,),
            "calibrated": (2, c),
            "moments": (c,),
        }
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} must have shape {shape}, not {getattr(self, name).shape}")
        if len(self.gauges) != c:
            raise ValueError(f"{c} components need {c} gauges, not {len(self.gauges)}")
        for name in ("load_scale", "output_scale"):
            if not ((getattr(self, name) > 0) & np.isfinite(getattr(self, name))).all():
                raise ValueError(f"{name} must be positive and finite")
        if np.shape(self.reading_noise) not in ((), (c,)):
            raise ValueError(f"reading_noise must be one number or have shape {(c,)}")
        noise = np.asarray(self.reading_noise)
        if not (np.isfinite(noise) & (noise >= 0)).all():
            raise ValueError(f"reading_noise must be zero or positive, and finite, not {self.reading_noise}")
        if self.natural_zero is not None and self.natural_zero.shape != (c,):
            raise ValueError(f"natural_zero must have shape {(c,)}, not {self.natural_zero.shape}")
        for item in self.terms:
            if not (0 <= item.kind < len(KINDS) and 0 <= item.first < c and 0 <= item.second < c):
                raise ValueError(f"{item} is no term of {c} variables")
        if c and not np.linalg.cond(self.linear) < 1 / np.finfo(float).eps:
            raise ValueError(
                "the linear terms of the matrix cannot be inverted: the gauges do not tell the loads apart"
            )

    def __repr__(self) -> str:
        loads = f"{', '.join(self.components)} [N, N*m]"
        return f"balance matrix, {self.way}: {loads} from {len(self.gauges)} outputs [mV/V], {len(self.terms)} terms"

    @property
    def linear(self) -> Array:
        """Coefficients of the linear terms, shape (c, c): results in rows, variables in columns."""
        return linear_part(self.terms, self.coefficients)

    @property
    def noise_of_readings(self) -> Array:
        """Standard deviation that `reading_noise` gives the residuals, normalised, shape (c,)."""
        gauges = self.reading_noise / self.output_scale
        return gauges if self.way == "iterative" else np.sqrt(self.linear**2 @ gauges**2)

    @property
    def direct(self) -> Array | None:
        """Matrix to NF PM SF YM RM AF (`to_direct`); None where names or distances are not known."""
        return to_direct(self.components, self.geometry)

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of the variables in the terms: loads in the iterative way, else bridges (r and their name)."""
        return self.components if self.way == "iterative" else tuple(f"r{name}" for name in self.gauges)

    @property
    def _active(self) -> tuple[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]], Array]:
        """Terms that are not zero throughout, as the kernels take them, and their coefficients."""
        rows = np.flatnonzero(self.coefficients.any(axis=1))
        return codes(tuple(self.terms[row] for row in rows)), np.ascontiguousarray(self.coefficients[rows])

    def outputs(self, loads: Array) -> Array:
        """Gauge outputs less zero [mV/V] at loads [N, N*m], both of shape (n, c)."""
        if self.way == "non-iterative":
            return inverted(*self._active, self.linear, loads, unit=self.load_scale, scale=self.output_scale)[0]
        return np.asarray(self._evaluate(np.ascontiguousarray(loads / self.load_scale)) * self.output_scale)

    def loads(self, outputs: Array) -> Solution:
        """Loads [N, N*m] at gauge outputs less zero [mV/V], both of shape (n, c).

        In the iterative way the iteration leaves an error of `inversion.TOLERANCE` of capacity at most.
        """
        if self.way == "iterative":
            return Solution(
                *inverted(*self._active, self.linear, outputs, unit=self.output_scale, scale=self.load_scale)
            )
        y = np.ascontiguousarray(outputs / self.output_scale)
        return Solution(self._evaluate(y) * self.load_scale, np.array(np.isfinite(y).all(axis=1), dtype=np.int64))

    def _evaluate(self, x: Array) -> Array:
        terms, coefficients = self._active
        parts = [
            kernels.design(*terms, x[start : start + CHUNK]) @ coefficients for start in range(0, x.shape[0], CHUNK)
        ]
        return np.concatenate(parts) if parts else np.zeros_like(x)

    def contraction(self, loads: Array) -> Array:
        """Factor by which the iteration of [R091]_ shrinks an error at these loads, shape (n,).

        It is the largest magnitude of an eigenvalue of I - C1^-1 J. At one or more the plain iteration would not
        converge and the loads may not be unique.
        """
        x = loads / self.load_scale if self.way == "iterative" else self.outputs(loads) / self.output_scale
        J = kernels.jacobians(*self._active[0], self._active[1], np.ascontiguousarray(x))
        return np.asarray(
            np.max(np.abs(np.linalg.eigvals(np.eye(x.shape[1]) - np.linalg.solve(self.linear, J))), axis=1)
        )

    def sensitivity(self, loads: Array) -> Array:
        """Derivatives of the loads by the outputs at these loads, shape (n, c, c) [N V/mV, N*m V/mV]."""
        if self.way == "iterative":
            x = np.ascontiguousarray(loads / self.load_scale)
            J = np.linalg.inv(kernels.jacobians(*self._active[0], self._active[1], x))
        else:
            x = np.ascontiguousarray(self.outputs(loads) / self.output_scale)
            J = kernels.jacobians(*self._active[0], self._active[1], x)
        return np.asarray(self.load_scale[:, None] * J / self.output_scale)

    def load_covariance(self, loads: Array, *, residual: bool = True, reading: bool = False) -> Array:
        """Covariance of loads computed with this matrix, from the calibration alone, shape (n, c, c) [N^2 ...].

        Parameters
        ----------
        loads
            Where, shape (n, c) [N, N*m].
        residual
            Whether the scatter of the calibration's residuals (lack of fit, and how well the balance
            repeats) is part of it, beside the coefficients.
        reading
            Whether `reading_noise` is left in that scatter: for a reading of the calibration's own kind.
        """
        scatter = self.residual_deviation**2 - (0 if reading else self.noise_of_readings**2)
        added = np.maximum(scatter, 0.0) if residual else np.zeros_like(scatter)
        parts = [
            self._covariance(np.ascontiguousarray(loads[start : start + CHUNK]), added)
            for start in range(0, loads.shape[0], CHUNK)
        ]
        c = len(self.components)
        return np.concatenate(parts) if parts else np.zeros((0, c, c))

    def _covariance(self, loads: Array, added: Array) -> Array:
        iterative = self.way == "iterative"
        x = loads / self.load_scale if iterative else self.outputs(loads) / self.output_scale
        H = kernels.design(*codes(self.terms), np.ascontiguousarray(x))
        variance = np.column_stack([np.sum((H @ part) * H, axis=1) for part in self.covariance]) + added
        deviation = np.sqrt(np.maximum(variance, 0.0))
        # residuals of one point go together from component to component, and so do the coefficients fitted to them
        S = deviation[:, :, None] * self.residual_correlation * deviation[:, None, :]
        if iterative:
            J = np.linalg.inv(kernels.jacobians(*self._active[0], self._active[1], np.ascontiguousarray(x)))
            S = J @ S @ np.swapaxes(J, 1, 2)
        return np.asarray(S * self.load_scale[:, None] * self.load_scale)

    def paper_form(self) -> PaperForm:
        """Coefficients of Eq. (2) of [Gorbushin2020]_; for a matrix with linear and quadratic terms only."""
        if self.way != "iterative" or any(term.kind not in MODELS["quadratic"] for term in self.terms):
            raise ValueError("Eq. (2) has linear and quadratic terms only, and is implicit in the loads")
        c = len(self.components)
        C = self.coefficients * self.output_scale
        own = np.zeros(c)
        cross, square = np.zeros((c, c)), np.zeros((c, c, c))
        for term, row in zip(self.terms, C, strict=True):
            if term.kind == 0:
                own[term.first] = row[term.first] / self.load_scale[term.first]
                cross[:, term.first] = -row / self.load_scale[term.first]
            else:
                square[:, term.first, term.second] = -row / (
                    self.load_scale[term.first] * self.load_scale[term.second]
                )
        np.fill_diagonal(cross, 0.0)
        return PaperForm(1 / own, cross / own[:, None], square / own[:, None, None])


class PaperForm(NamedTuple):
    """Eq. (2) of [Gorbushin2020]_: X_i = a_i N_i + sum_j a_ij X_j + sum_{r<=s} a_irs X_r X_s.

    Attributes
    ----------
    own
        a_i, shape (c,) [N V/mV].
    cross
        a_ij, zero on the diagonal, shape (c, c).
    square
        a_irs, zero where r > s, shape (c, c, c).
    """

    own: Array
    cross: Array
    square: Array
