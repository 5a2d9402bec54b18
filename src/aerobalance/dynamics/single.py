r"""The balance with its model as a damped spring, and the closed forms that follow from it.

Symbols of [Gorbushin2020]_: M moving mass, k stiffness, b damping, w0 = sqrt(k/M), f0 = w0 / 2 pi, AF the elastic
load, F the applied force, x1 the ground end. Time dependence is exp(+i w t).

References
----------
.. [Gorbushin2020] A. R. Gorbushin, A. A. Bolshakova, "Unsteady axial force measurement by the strain gauge balance",
   Measurement 152 (2020) 107381. https://doi.org/10.1016/j.measurement.2019.107381
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerobalance.dynamics.modal import ModalModel, Mode
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, dynamics_units
from aerobalance.recording.gravity import gravity_share
from aerobalance.recording.wording import with_u

PARAMETERS: Final = ("mass", "stiffness", "damping", "delay")
"""Order of the first rows and columns of `Dynamics.covariance`."""

MODE_PARAMETERS: Final = ("natural_frequency", "damping_ratio", "share")
"""Order of the rows and columns that every further mode adds to `Dynamics.covariance`."""


@dataclass(frozen=True, slots=True, eq=False)
class Dynamics(ModalModel):
    """Moving mass, stiffness and damping of one component, and the further modes that it has.

    One mode is the paper's balance, Eq. (8) of [Gorbushin2020]_, whose gauges read the elastic force AF = k x alone,
    Eq. (3). With more modes, AF/F is the sum of the modes' responses, each times its share of a steady load; the
    shares add to 1, so the first mode has what the further ones leave. They belong to the place where the force acts.

    Attributes
    ----------
    component
        Which component this is, from `aerobalance.recording.components.COMPONENTS`.
    mass
        Moving mass M: live end of the balance and model [kg; kg*m for a moment on one axis of motion].
    stiffness
        Stiffness k of the sensing element along the component [N/m; N for a moment]; with `mass` the frequency of the
        first mode.
    damping
        Damping coefficient b of the first mode, force per velocity of the extension [N*s/m; N*s for
        a moment].
    delay
        Time by which the load readings lag the ground acceleration [s]; may have either sign.
    covariance
        Covariance of `parameters`, shape (4 + 3 m, 4 + 3 m), in the units above; all zero where not given.
    further_modes
        The m modes beside the first.
    identified_load
        Largest load of the record that they were identified from [N; N*m]; 0 where that is not known.
    """

    component: str
    mass: float
    stiffness: float
    damping: float
    delay: float = 0.0
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    further_modes: tuple[Mode, ...] = ()
    identified_load: float = 0.0

    def __post_init__(self) -> None:
        if self.component not in COMPONENTS:
            raise ValueError(f"component must be one of {', '.join(COMPONENTS)}, not {self.component!r}")
        for name in ("mass", "stiffness"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive and finite, not {getattr(self, name)}")
        if not 0 <= self.damping < np.inf:
            raise ValueError(f"damping must be zero or more and finite, not {self.damping}")
        if not np.isfinite(self.delay):
            raise ValueError(f"delay must be finite, not {self.delay}")
        size = len(self.parameters)
        if self.covariance.size == 0:
            object.__setattr__(self, "covariance", np.zeros((size, size)))
        if self.covariance.shape != (size, size):
            raise ValueError(f"covariance must have shape ({size}, {size}), not {self.covariance.shape}")
        if not np.isfinite(self.covariance).all() or (np.diag(self.covariance) < 0).any():
            raise ValueError("covariance must be finite, with variances of zero or more")
        if not 0 <= self.identified_load < np.inf:
            raise ValueError(f"identified_load must be zero or more and finite, not {self.identified_load}")

    def __repr__(self) -> str:
        told = {name: self.uncertainty(name) for name in (*PARAMETERS, "natural_frequency", "damping_ratio")}
        units = dynamics_units(self.component) | {"damping_ratio": ""}
        shown = [name for name in told if name != "delay" or self.delay or told[name]]
        rows = [f"{name} {with_u(getattr(self, name), told[name], units[name])}".replace("_", " ") for name in shown]
        further = zip(self.further_modes, self.modes.uncertainties[1:], strict=True)
        rows += [f"further mode {one.told(float(u[0]), float(u[1]))}" for one, u in further]
        return "\n  ".join([f"dynamics of {self.component}", *rows])

    @property
    def components(self) -> tuple[str, ...]:
        """The one component, as dynamics of several have more."""
        return (self.component,)

    def weight(self, name: str, *, pitch: Array, roll: Array, gravity: float) -> Array:
        """Weight of the moving mass along the component [N; N*m], shape (n,), at attitudes of shape (n,) [rad]."""
        return self.mass * gravity * gravity_share(name, pitch=pitch, roll=roll)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the rows of `covariance`: `PARAMETERS`, then those of each further mode, such as share_2."""
        further = range(2, 2 + len(self.further_modes))
        return (*PARAMETERS, *(f"{name}_{number}" for number in further for name in MODE_PARAMETERS))

    def with_modes(self, *further: Mode) -> Dynamics:
        """The same balance with these further modes, taken as known exactly."""
        size = len(PARAMETERS) + len(MODE_PARAMETERS) * len(further)
        covariance = np.zeros((size, size))
        covariance[: len(PARAMETERS), : len(PARAMETERS)] = self.covariance[: len(PARAMETERS), : len(PARAMETERS)]
        return replace(self, covariance=covariance, further_modes=further)

    def retuned(self, *, frequency: float, damping: float) -> Dynamics:
        """The same balance with natural frequency and damping ratio of its first mode times these factors [1]."""
        return replace(self, stiffness=self.stiffness * frequency**2, damping=self.damping * frequency * damping)

    def with_parameters(self, values: Array) -> Dynamics:
        """The same balance with other values of `parameters`, shape (4 + 3 m,); the covariance is left out.

        Raises
        ------
        ValueError
            A value is not physical.
        """
        further = np.reshape(values[len(PARAMETERS) :], (-1, len(MODE_PARAMETERS)))
        mass, stiffness, damping, delay = (float(value) for value in values[: len(PARAMETERS)])
        modes = tuple(Mode(*(float(value) for value in row)) for row in further)
        load = self.identified_load
        return Dynamics(self.component, mass, stiffness, damping, delay, further_modes=modes, identified_load=load)

    @property
    def exact(self) -> Dynamics:
        """The same balance, taken as known exactly."""
        return self.with_parameters(self.values)

    @property
    def values(self) -> Array:
        """Values of `parameters`, shape (4 + 3 m,)."""
        further = [(mode.natural_frequency, mode.damping_ratio, mode.share) for mode in self.further_modes]
        return np.array([self.mass, self.stiffness, self.damping, self.delay, *np.ravel(further)])

    @property
    def angular_frequency(self) -> float:
        """Undamped natural angular frequency w0 = sqrt(k / M), Eq. (8) of [Gorbushin2020]_ [rad/s]."""
        return float(np.sqrt(self.stiffness / self.mass))

    @property
    def natural_frequency(self) -> float:
        """Undamped natural frequency f0 = w0 / 2 pi [Hz]."""
        return self.angular_frequency / (2 * np.pi)

    @property
    def damping_ratio(self) -> float:
        """Damping over critical damping, b / (2 sqrt(k M)) [1]."""
        return float(self.damping / (2 * np.sqrt(self.stiffness * self.mass)))

    @property
    def quadratic(self) -> tuple[float, float]:
        """D = b / k [s] and A = M / k [s^2] of Eq. (17) of [Gorbushin2020]_, F = AF + D AF' + A AF''."""
        return self.damping / self.stiffness, self.mass / self.stiffness

    @property
    def decay_rate(self) -> float:
        """Decay rate of a free oscillation, b / 2M [1/s]."""
        return self.damping / (2 * self.mass)

    @property
    def damped_angular_frequency(self) -> float:
        """Angular frequency of a free oscillation, Eq. (19) of [Gorbushin2020]_ [rad/s].

        Raises
        ------
        ValueError
            The balance is damped critically or more and does not oscillate.
        """
        square = self.angular_frequency**2 - self.decay_rate**2
        if square <= 0:
            raise ValueError(f"damping ratio {self.damping_ratio:.3g}: no free oscillation at or above 1")
        return float(np.sqrt(square))

    @property
    def damped_frequency(self) -> float:
        """Frequency of a free oscillation [Hz]."""
        return self.damped_angular_frequency / (2 * np.pi)

    def uncertainty(self, parameter: str) -> float:
        """Standard uncertainty of one of `parameters`, or of natural_frequency [Hz], damping_ratio or share [1]."""
        gradient = self.gradient(parameter)
        return float(np.sqrt(max(float(gradient @ self.covariance @ gradient), 0.0)))

    def gradient(self, parameter: str) -> Array:
        """Derivative of a parameter or derived quantity with respect to `parameters`, shape (4 + 3 m,).

        natural_frequency, damping_ratio and share without a number are those of the first mode.
        """
        names = self.parameters
        gradient: Array = np.zeros(len(names))
        if parameter in names:
            gradient[names.index(parameter)] = 1.0
        elif parameter == "natural_frequency":
            f0 = self.natural_frequency
            gradient[:2] = -f0 / (2 * self.mass), f0 / (2 * self.stiffness)
        elif parameter == "damping_ratio":
            half = -self.damping_ratio / 2
            gradient[:3] = half / self.mass, half / self.stiffness, 1 / (2 * np.sqrt(self.stiffness * self.mass))
        elif parameter == "share":
            gradient[[index for index, name in enumerate(names) if name.startswith("share")]] = -1.0
        else:
            raise ValueError(f"parameter must be one of {', '.join(names)}, natural_frequency, damping_ratio, share")
        return gradient

    def _mode_uncertainties(self) -> Array:
        numbers = ["", *(f"_{number}" for number in range(2, 2 + len(self.further_modes)))]
        names = ("natural_frequency", "damping_ratio")
        return np.array([[self.uncertainty(f"{name}{number}") for name in names] for number in numbers])

    def force_slopes(self, frequency: Array) -> NDArray[np.complex128]:
        """Change of the force of Eq. (17) of [Gorbushin2020]_ with each of `parameters`, over the force, (m, p).

        Parameters
        ----------
        frequency
            Frequencies, shape (m,) [Hz].
        """
        first, *further = self.modes
        s = 2j * np.pi * frequency
        M, k, b = self.mass, self.stiffness, self.damping
        # dG/dp; the first mode is 1 / (1 + s b/k + s^2 M/k), and the derivative of 1/D is -D' / D^2
        own = -first.share * first.response(frequency) ** 2
        slopes = {
            "mass": own * s**2 / k,
            "stiffness": -own * (s * b + s**2 * M) / k**2,
            "damping": own * s / k,
            # the delay is that of the load behind the ground's acceleration: it does not touch F/AF
            "delay": np.zeros_like(s),
        }
        for number, mode in enumerate(further, 2):
            f, zeta = mode.natural_frequency, mode.damping_ratio
            ratio = frequency / f
            curve = -mode.share * mode.response(frequency) ** 2
            slopes[f"natural_frequency_{number}"] = curve * 2 * (ratio**2 - 1j * zeta * ratio) / f
            slopes[f"damping_ratio_{number}"] = curve * 2j * ratio
            slopes[f"share_{number}"] = mode.response(frequency) - first.response(frequency)
        of_response = np.column_stack([slopes[name] for name in self.parameters])
        return np.asarray(-of_response / self.response(frequency)[:, None])

    def base_response(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Balance load over ground acceleration, AF/x1'' [kg], at frequencies [Hz], for F = 0.

        Its modulus is Eq. (12) of [Gorbushin2020]_ and the lag of AF behind x1 is Eq. (11), both in `extension_lag`
        and `amplitude`; the delay of the load channel is included.
        """
        lag = np.exp(-2j * np.pi * np.asarray(frequency) * self.delay)
        return np.asarray(-self.mass * self.response(frequency) * lag, dtype=np.complex128)

    def amplitude(self, frequency: ArrayLike, acceleration: ArrayLike) -> Array:
        """Amplitude of the balance load on a shaken base, Eq. (12) of [Gorbushin2020]_ [N].

        Parameters
        ----------
        frequency
            Frequency of the ground motion [Hz].
        acceleration
            Amplitude A1 of the ground acceleration [m/s^2].
        """
        return np.asarray(self.mass * np.abs(self.response(frequency)) * np.asarray(acceleration))

    def extension_lag(self, frequency: ArrayLike) -> Array:
        """Phase by which the extension lags the ground displacement x1, Eq. (11) of [Gorbushin2020]_ [rad]."""
        return np.asarray(-np.angle(self.response(frequency)))


def extremum_ratio(damping: float, mass: float, period: float, half_periods: ArrayLike) -> Array:
    """Extrema of a free decay over the first one, Eq. (7) of [Gorbushin2020]_ [1].

    Parameters
    ----------
    damping, mass
        b [N*s/m] and M [kg].
    period
        Period of the free oscillation [s].
    half_periods
        Number n of half periods since the first extremum.
    """
    return np.asarray(np.exp(-damping * period * np.asarray(half_periods) / (4 * mass)))


def stiffness_from_damped_frequency(frequency: float, mass: float, damping: float) -> float:
    """Stiffness k = 4 pi^2 f^2 M + b^2 / 4M from the damped frequency f [Hz], Eq. (20) of [Gorbushin2020]_ [N/m]."""
    return 4 * np.pi**2 * frequency**2 * mass + damping**2 / (4 * mass)
