r"""Decoupled components: readings of which each is that of a balance with one component.

Row i of F = X + D X' + A X'' gives F_i with noise of the spectrum N_i = r R r*, r_j = delta_ij + D_ij s + A_ij s^2,
and R the covariance of the channels' noise. It is a polynomial of second degree in the square of the frequency, so it
has a stable factor, N_i = R_ii |1 + d s + a s^2|^2: the noise with which a balance of one component, of mass over
stiffness a and damping over stiffness d, would give F_i.
What that balance would read,

    z_i = (X_i + sum_j (D_ij s + A_ij s^2) X_j) / (1 + d s + a s^2) = G_i F_i + white noise of variance R_ii,

is found from the readings without any derivative of them, and contains nothing of the other components' forces. All
that is done with one component is done with z_i; where row i of D and A has no other components, z_i is X_i.

With internal coordinates row i is q F_i = sum_j p_ij X_j (`aerobalance.dynamics.condensation`). N_i is that of p over
q, its spectral factor has one mode more than there are internal coordinates, and G_i = q over that factor is a balance
with these modes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from aerobalance.dynamics.condensation import Condensed, modes_of, partial_fractions, spectral_factor
from aerobalance.dynamics.driven_modes import DrivenModes, responses, values_and_rates
from aerobalance.dynamics.modal import EquivalentModel, ModalModel, Mode
from aerobalance.recording.channel import Array


@dataclass(frozen=True, slots=True, eq=False)
class Fractions:
    """Partial fractions of transfer functions: a direct part, and for each mode one of its value and one of its rate.

    Attributes
    ----------
    direct
        Weight of each of c series, shape (c,).
    modes
        The m modes.
    by_value, by_rate
        What each series drives a mode with to show as value and as rate, shape (m, c) and the same [s].
    """

    direct: Array
    modes: tuple[Mode, ...]
    by_value: Array
    by_rate: Array

    @classmethod
    def of(cls, polynomials: Array, modes: Sequence[Mode]) -> Fractions:
        """Polynomials in s, shape (c, k) with rising powers, over the product of the modes."""
        direct, values, rates = partial_fractions(polynomials, modes)
        return cls(direct, tuple(modes), values.T, rates.T)

    def through(self, series: Array, *, interval: float) -> Array:
        """Response to series of shape (samples, c), at rest before (`DrivenModes`); shape (samples,)."""
        found = series @ self.direct
        if not self.modes:
            return np.asarray(found)
        first = series[0]
        driving = np.stack([(series - first) @ by.T for by in (self.by_value, self.by_rate)], axis=1)
        responses = DrivenModes(self.modes, interval=interval).whole(driving)
        return np.asarray(found + (self.by_value @ first).sum() + responses.sum(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class DecoupledChannel:
    """The single-input model that gives a component's force with the same noise as the coupled balance.

    Attributes
    ----------
    place
        Row of the component.
    dynamics
        That model.
    row
        What its reading is of the balance loads, over the product of its modes: powers of s, shape (n, 2 e + 3).
    internal
        Loads in internal springs by the balance loads, shape (e, n, 2 e + 1), over the product of `still`.
    still
        Motions in which no component shows anything, e of them.
    carried
        What the reading is of a term more in the equation of the component itself and of every internal coordinate,
        over the product of its modes, shape (1 + e, 2 e + 1).
    """

    place: int
    dynamics: ModalModel
    row: Array
    internal: Array
    still: tuple[Mode, ...]
    carried: Array

    @classmethod
    def of(cls, component: str, place: int, equations: Condensed, *, noise: Array) -> DecoupledChannel:
        """Return how one of coupled components is decoupled from the others.

        Parameters
        ----------
        component, place
            Which of them, and its row.
        equations
            Their equations of motion.
        noise
            Covariance of the noise of a reading, shape (n, n) [N^2, N^2*m, N^2*m^2]; the ratios are what matters.

        Raises
        ------
        ValueError
            An internal coordinate moves without end while no component shows anything.
        """
        row, common = equations.forces[place], equations.common
        still = modes_of(equations.still)
        if still or np.delete(row, place, axis=0).any():
            own = _equivalent(component, spectral_factor(_spectrum(row, noise) / noise[place, place]), common)
        else:
            own = EquivalentModel(component, Mode.of_quadratic(float(row[place, 1]), float(row[place, 2])))
        return cls(place, own, row, equations.internal, still, np.vstack([common, -equations.carried[place]]))

    @classmethod
    def apart(cls, model: ModalModel, place: int, *, count: int) -> DecoupledChannel:
        """Return that of a component, in one row of so many, that no other has a part in: its own reading."""
        numerator, denominator = model.polynomials
        row = np.zeros((count, denominator.size))
        row[place] = denominator
        return cls(place, model, row, np.zeros((0, count, 1)), (), numerator[None])

    @property
    def component(self) -> str:
        """Name of the component."""
        return self.dynamics.component

    @property
    def partners(self) -> NDArray[np.bool_]:
        """True for the component itself and for those that have a part in its reading, shape (n,)."""
        return np.asarray(self.row.any(axis=1))

    @property
    def alone(self) -> bool:
        """True where its reading is that of its own channel."""
        return int(np.count_nonzero(self.partners)) == 1 and not self.still

    def reading(self, loads: Array, *, interval: float) -> Array:
        """Reading of the decoupled component when the coupled balance reads these loads, shape (samples,) [N, N*m].

        Before its first sample the loads are as in `DrivenModes`; another past of them is a free oscillation of z.

        Parameters
        ----------
        loads
            Shape (samples, n), without gaps.
        interval
            Time between samples [s].
        """
        if self.alone:
            return loads[:, self.place].copy()
        return self.fractions.through(loads, interval=interval)

    @property
    def fractions(self) -> Fractions:
        """Transfer functions from the balance loads to its reading, as partial fractions."""
        if self.alone:
            none = np.zeros((len(self.dynamics.modes), len(self.row)))
            return Fractions(self.partners.astype(np.float64), self.dynamics.modes, none, none)
        return Fractions.of(self.row, self.dynamics.modes)

    def noise_response(self, frequency: Array) -> NDArray[np.complex128]:
        """Frequency response of its reading to every channel, at frequencies of shape (m,) [Hz]; shape (m, n)."""
        s = 2j * np.pi * np.asarray(frequency, dtype=np.float64)
        whole = np.stack([polynomial.polyval(s, powers) for powers in self.row], axis=-1)
        for mode in self.dynamics.modes:
            w = mode.angular_frequency
            whole = whole / (1 + 2 * mode.damping_ratio * s / w + (s / w) ** 2)[:, None]
        return np.asarray(whole)

    @property
    def rows(self) -> NDArray[np.intp]:
        """Which of the parameters of the coupled dynamics have a part in the reading: the columns of the slopes."""
        return parameter_rows(self.place, components=len(self.row), internal=len(self.internal))

    def parameter_slopes(self, loads: Array, *, interval: float) -> Array:
        """Change of `reading` with each element of `rows`: of A, equation by equation, then of D; (samples, k)."""
        internal = [self._inside(loads, place, interval=interval) for place in range(len(self.still))]
        coordinates = np.column_stack([loads, *internal])
        count, number = coordinates.shape
        numerators = [
            np.concatenate([np.zeros(power), error, np.zeros(2 - power)])[: self.row.shape[1]]
            for power in (2, 1)
            for error in self.carried
        ]
        parts = [Fractions.of(one[None], self.dynamics.modes) for one in numerators]
        columns = np.empty((len(parts), number, count))
        for one, column in zip(parts, columns, strict=True):
            np.multiply(coordinates.T, one.direct[0], out=column)
        for place, mode in enumerate(self.dynamics.modes):
            for coordinate in range(number):  # one by one, as each takes room
                value, rate = values_and_rates(mode, coordinates[:, [coordinate]], interval=interval)
                for one, column in zip(parts, columns, strict=True):
                    column[coordinate] += one.by_value[place, 0] * value[0] + one.by_rate[place, 0] * rate[0]
        return columns.reshape(-1, count).T

    def response_to(self, net: Array, *, interval: float) -> Array:
        """Reading under forces of its own component that are band-limited, both of shape (samples, c) [N, N*m].

        What the balance feels of forces on the other components is not in it: that is what it is decoupled from.
        """
        parts = Fractions.of(self.carried[:1], self.dynamics.modes)
        whole = parts.direct[0] * net.T
        for mode, by_value, by_rate in zip(parts.modes, parts.by_value[:, 0], parts.by_rate[:, 0], strict=True):
            weights = {"by_value": float(by_value), "by_rate": float(by_rate)}
            for column in range(net.shape[1]):  # one by one, as each takes room
                whole[column] += responses(mode, net[:, [column]], interval=interval, **weights)[0]
        return np.asarray(whole.T)

    def _inside(self, loads: Array, place: int, *, interval: float) -> Array:
        """Load in an internal spring, shape (samples,)."""
        return Fractions.of(self.internal[place], self.still).through(loads, interval=interval)


def parameter_rows(place: int, *, components: int, internal: int) -> NDArray[np.intp]:
    """Elements of A and D in the equation of one component and in those of the internal coordinates, shape (k,)."""
    size = components + internal
    element = np.arange(2 * size * size).reshape(2, size, size)
    return np.asarray(element[:, [place, *range(components, size)]].ravel())


def _spectrum(row: Array, noise: Array) -> Array:
    """Spectrum of noise behind a row of polynomials: its coefficients of s^0, s^2, ..."""
    signs = (-1.0) ** np.arange(row.shape[1])
    found = np.zeros(2 * row.shape[1] - 1)
    for one in range(len(row)):
        for other in range(len(row)):
            if noise[one, other]:
                found += noise[one, other] * np.convolve(row[one], row[other] * signs)
    return found[::2]


def _equivalent(component: str, modes: Sequence[Mode], common: Array) -> EquivalentModel:
    """The model of one component whose response is a polynomial over the product of modes."""
    _, shares, rates = partial_fractions(common, modes)
    further = [
        Mode(mode.natural_frequency, mode.damping_ratio, float(share), float(rate))
        for mode, share, rate in list(zip(modes, shares, rates, strict=True))[1:]
    ]
    return EquivalentModel(component, modes[0], tuple(further))
