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
from scipy.signal import lfilter

from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.gravity import gravity_share

PARAMETERS: Final = ("mass", "stiffness", "damping", "delay")
"""Order of the first rows and columns of `Dynamics.covariance`."""

MODE_PARAMETERS: Final = ("natural_frequency", "damping_ratio", "share")
"""Order of the rows and columns that every further mode adds to `Dynamics.covariance`."""


@dataclass(frozen=True, slots=True)
class Mode:
    """One mode of the balance with its model: q'' + 2 zeta w q' + w^2 q = w^2 N under the net force N.

    Attributes
    ----------
    natural_frequency
        Undamped natural frequency w / 2 pi [Hz].
    damping_ratio
        Damping ratio zeta [1].
    share
        Share of a steady load that the mode carries, r / w^2 [1]; of either sign.
    rate_share
        What the mode shows of its rate beside, [s]: share + rate_share s over N. Zero but in one of several
        components (`aerobalance.dynamics.decoupling`), where the modes' swings are not in phase.
    """

    natural_frequency: float
    damping_ratio: float
    share: float = 1.0
    rate_share: float = 0.0

    def __post_init__(self) -> None:
        if not 0 < self.natural_frequency < np.inf:
            raise ValueError(f"natural_frequency must be positive and finite, not {self.natural_frequency}")
        if not 0 <= self.damping_ratio < np.inf:
            raise ValueError(f"damping_ratio must be zero or more and finite, not {self.damping_ratio}")
        for name in ("share", "rate_share"):
            if not np.isfinite(getattr(self, name)):
                raise ValueError(f"{name} must be finite, not {getattr(self, name)}")

    @property
    def angular_frequency(self) -> float:
        """Undamped natural angular frequency w [rad/s]."""
        return 2 * np.pi * self.natural_frequency

    @property
    def poles(self) -> tuple[complex, complex]:
        """The two poles [rad/s]; real when the damping ratio is above 1."""
        w, decay = self.angular_frequency, self.damping_ratio * self.angular_frequency
        split = np.sqrt(complex(decay**2 - w**2))
        split = split or 1e-6 * w  # critical damping: a double pole has no partial fractions
        return -decay + split, -decay - split

    def response(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """q/N at frequencies [Hz]; 1 at rest."""
        ratio = np.asarray(frequency) / self.natural_frequency
        return np.asarray(1 / (1 - ratio**2 + 2j * self.damping_ratio * ratio), dtype=np.complex128)

    def free_decay(self, time: ArrayLike) -> Array:
        """Release from rest at time 0, over the load held before [1]."""
        t = np.maximum(np.asarray(time, dtype=np.float64), 0.0)
        p, q = self.poles
        return np.asarray(np.real((p * np.exp(q * t) - q * np.exp(p * t)) / (p - q)))

    def free_decay_rate(self, time: ArrayLike) -> Array:
        """Rate of `free_decay` [1/s]."""
        t = np.maximum(np.asarray(time, dtype=np.float64), 0.0)
        p, q = self.poles
        return np.asarray(np.real(p * q * (np.exp(q * t) - np.exp(p * t)) / (p - q)))

    def integrated_step(self, time: Array) -> Array:
        """Integral of the response to a step of 1 at time 0, from 0 to time [s]."""
        t = np.maximum(time, 0.0)
        p, q = self.poles
        swing = q / p * np.expm1(p * t) - p / q * np.expm1(q * t)
        return np.asarray(t + np.real(swing / (p - q)))

    def driven(self, net: Array, *, interval: float) -> tuple[Array, Array]:
        """Response and its rate under a net force that is linear between samples, held before; shape (n,) each."""
        response, rate = np.zeros((2, net.size), dtype=np.complex128)
        change = net - net[0]
        before = np.concatenate(([0.0], change[:-1]))
        p, q = self.poles
        for pole, sign in ((p, 1.0), (q, -1.0)):
            growth = np.exp(pole * interval)
            late = (np.expm1(pole * interval) - pole * interval) / (pole**2 * interval)
            early = np.expm1(pole * interval) / pole - late
            part = sign * lfilter([1.0], [1.0, -growth], early * before + late * change)
            response += part
            rate += pole * part
        size = self.angular_frequency**2 / (p - q)
        return np.asarray(net[0] + np.real(response * size)), np.asarray(np.real(rate * size))


@dataclass(frozen=True, slots=True, eq=False)
class Dynamics:
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
        Stiffness k of the sensing element along the component [N/m]; with `mass` the frequency of the first mode.
    damping
        Damping coefficient b of the first mode, force per velocity of the extension [N*s/m].
    delay
        Time by which the load readings lag the ground acceleration [s]; may have either sign.
    covariance
        Covariance of `parameters`, shape (4 + 3 m, 4 + 3 m), in the units above; all zero where not given.
    further_modes
        The m modes beside the first.
    """

    component: str
    mass: float
    stiffness: float
    damping: float
    delay: float = 0.0
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    further_modes: tuple[Mode, ...] = ()

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

    @property
    def components(self) -> tuple[str, ...]:
        """The one component, as dynamics of several have more."""
        return (self.component,)

    def weight(self, name: str, *, pitch: Array, roll: Array, gravity: float) -> Array:
        """Weight of the moving mass along the component [N], shape (n,), at attitudes of shape (n,) [rad]."""
        return self.mass * gravity * gravity_share(name, pitch=pitch, roll=roll)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the rows of `covariance`: `PARAMETERS`, then those of each further mode, such as share_2."""
        further = range(2, 2 + len(self.further_modes))
        return (*PARAMETERS, *(f"{name}_{number}" for number in further for name in MODE_PARAMETERS))

    @property
    def modes(self) -> tuple[Mode, ...]:
        """All modes, the first one first."""
        share = 1.0 - sum(mode.share for mode in self.further_modes)
        # a force changes the load's rate, not the load, at once: the rates that the modes show at first cancel
        at_once = sum(mode.rate_share * mode.natural_frequency**2 for mode in self.further_modes)
        rate_share = -at_once / self.natural_frequency**2
        return (Mode(self.natural_frequency, self.damping_ratio, share, rate_share), *self.further_modes)

    def with_modes(self, *further: Mode) -> Dynamics:
        """The same balance with these further modes, taken as known exactly."""
        size = len(PARAMETERS) + len(MODE_PARAMETERS) * len(further)
        covariance = np.zeros((size, size))
        covariance[: len(PARAMETERS), : len(PARAMETERS)] = self.covariance[: len(PARAMETERS), : len(PARAMETERS)]
        return replace(self, covariance=covariance, further_modes=further)

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
        return Dynamics(self.component, mass, stiffness, damping, delay, further_modes=modes)

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

    def response(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Load felt over force applied, AF/F, at frequencies [Hz]; the transform of Eq. (8) with x1 at rest.

        The delay is not included.
        """
        s = 2j * np.pi * np.asarray(frequency)
        parts = ((mode.share + mode.rate_share * s) * mode.response(frequency) for mode in self.modes)
        return np.asarray(sum(parts), dtype=np.complex128)

    def base_response(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Load felt over ground acceleration, AF/x1'' [kg], at frequencies [Hz], for F = 0.

        Its modulus is Eq. (12) of [Gorbushin2020]_ and the lag of AF behind x1 is Eq. (11), both in `extension_lag`
        and `amplitude`; the delay of the load channel is included.
        """
        lag = np.exp(-2j * np.pi * np.asarray(frequency) * self.delay)
        return np.asarray(-self.mass * self.response(frequency) * lag, dtype=np.complex128)

    def amplitude(self, frequency: ArrayLike, acceleration: ArrayLike) -> Array:
        """Amplitude of the load felt on a shaken base, Eq. (12) of [Gorbushin2020]_ [N].

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

    @property
    def poles(self) -> tuple[complex, complex]:
        """The two poles of Eq. (8) of [Gorbushin2020]_ [rad/s]; real when the damping ratio is above 1."""
        return self.modes[0].poles

    def free_decay(self, time: ArrayLike) -> Array:
        """Release from rest at time 0, over the load held before, Eq. (6) of [Gorbushin2020]_ [1].

        The sine term that (6) leaves out makes the velocity at release zero; with it the extrema of (7) are exact.
        It is 1 before the release.
        """
        parts = (
            mode.share * mode.free_decay(time) + mode.rate_share * mode.free_decay_rate(time) for mode in self.modes
        )
        return np.asarray(sum(parts))

    def step_response(self, time: ArrayLike, *, duration: float = 0.0) -> Array:
        """Load felt after a force of 1 N is applied at time 0, at once or linearly over a duration.

        Parameters
        ----------
        time
            Time since the force began to change [s]; the response is 0 before.
        duration
            Time over which the force rises from 0 to 1 N [s].
        """
        t = np.asarray(time, dtype=np.float64)
        if duration <= 0:
            return 1 - self.free_decay(t)
        late = t - duration
        risen = (
            mode.share * (mode.integrated_step(t) - mode.integrated_step(late))
            + mode.rate_share * (mode.free_decay(late) - mode.free_decay(t))
            for mode in self.modes
        )
        return np.asarray(sum(risen) / duration)

    def load_felt(self, net: Array, *, interval: float) -> Array:
        """Load felt under a net force that is linear between samples: Eq. (8) integrated exactly.

        Parameters
        ----------
        net
            Net force on the moving mass, F + M g sin(theta) - M x1'', shape (n,) [N]; before its first sample it is
            held at that value and the balance is at rest.
        interval
            Time between samples [s].
        """
        whole = np.zeros(net.shape)
        for mode in self.modes:
            load, rate = mode.driven(net, interval=interval)
            whole += mode.share * load + mode.rate_share * rate
        return whole


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
