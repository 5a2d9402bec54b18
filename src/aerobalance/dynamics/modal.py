"""The modal model of one component: how its load follows the force through one mode or several, in closed form.

AF/F is the sum of the modes' responses, each times its participation in a steady load (and, where components are
coupled, in its rate). A mass on a damped spring, `aerobalance.dynamics.single.Dynamics`, and the single-input model of
a decoupled channel, `EquivalentModel`, are two sets of parameters of it. The estimator takes either.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import reduce
from typing import Final, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerobalance.dynamics._kernels import first_order
from aerobalance.recording.channel import Array
from aerobalance.recording.wording import with_u

FEW: Final = 512
"""Times for which exponentials are taken one by one."""

EVEN: Final = 1e-12
"""Error of a phase up to which times are evenly spaced [rad]."""


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

    def __repr__(self) -> str:
        return self.told()

    def __post_init__(self) -> None:
        if not 0 < self.natural_frequency < np.inf:
            raise ValueError(f"natural_frequency must be positive and finite, not {self.natural_frequency}")
        if not 0 <= self.damping_ratio < np.inf:
            raise ValueError(f"damping_ratio must be zero or more and finite, not {self.damping_ratio}")
        for name in ("share", "rate_share"):
            if not np.isfinite(getattr(self, name)):
                raise ValueError(f"{name} must be finite, not {getattr(self, name)}")

    @classmethod
    def of_quadratic(cls, damping: float, inertia: float) -> Mode:
        """The mode of F = X + D X' + A X'' with D [s] and A [s^2]."""
        w = inertia**-0.5
        return cls(w / (2 * np.pi), damping * w / 2)

    def told(self, u_natural_frequency: float = 0.0, u_damping_ratio: float = 0.0) -> str:
        """The mode in a line, with the standard uncertainties of frequency [Hz] and damping ratio [1] where known."""
        frequency = with_u(self.natural_frequency, u_natural_frequency, "Hz")
        damping = with_u(self.damping_ratio, u_damping_ratio) if u_damping_ratio > 0 else f"{self.damping_ratio:.3g}"
        share = "" if self.share == 1 else f", share {self.share:.3g}"
        return f"{frequency}, damping ratio {damping}{share}"

    @property
    def angular_frequency(self) -> float:
        """Undamped natural angular frequency w [rad/s]."""
        return 2 * np.pi * self.natural_frequency

    @property
    def quadratic(self) -> tuple[float, float]:
        """D [s] and A [s^2] of N = q + D q' + A q''."""
        return 2 * self.damping_ratio / self.angular_frequency, self.angular_frequency**-2

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
        p, q = self.poles
        fall = exponentials(p, time)
        if p.imag:  # q is the conjugate of p
            return np.asarray((p * fall.conj()).imag / p.imag)
        return np.asarray(np.real((p * exponentials(q, time) - q * fall) / (p - q)))

    def free_decay_rate(self, time: ArrayLike) -> Array:
        """Rate of `free_decay` [1/s]."""
        p, q = self.poles
        fall = exponentials(p, time)
        if p.imag:
            return np.asarray(-(abs(p) ** 2) / p.imag * fall.imag)
        return np.asarray(np.real(p * q * (exponentials(q, time) - fall) / (p - q)))

    def integrated_step(self, time: Array) -> Array:
        """Integral of the response to a step of 1 at time 0, from 0 to time [s]."""
        p, q = self.poles
        fall = exponentials(p, time)
        if p.imag:
            swing = (q / p * (fall - 1)).imag / p.imag
        else:
            swing = np.real((q / p * (fall - 1) - p / q * (exponentials(q, time) - 1)) / (p - q))
        return np.asarray(np.maximum(time, 0.0) + swing)

    def released(self, time: ArrayLike) -> Array:
        """Its part of a balance load after a release from rest at time 0, over the load held before [1]."""
        part = self.share * self.free_decay(time)
        return part + self.rate_share * self.free_decay_rate(time) if self.rate_share else part

    def risen(self, time: Array) -> Array:
        """Its part of the integral of the balance load after a step of 1 at time 0 [s]."""
        part = self.share * self.integrated_step(time)
        return part - self.rate_share * self.free_decay(time) if self.rate_share else part

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
            part = sign * first_order(growth, early * before + late * change)
            response += part
            rate += pole * part
        size = self.angular_frequency**2 / (p - q)
        return np.asarray(net[0] + np.real(response * size)), np.asarray(np.real(rate * size))


class Modes(tuple[Mode, ...]):
    """Modes, printed a line each with their standard uncertainties.

    Parameters
    ----------
    modes
        The m modes.
    uncertainties
        Gives the standard uncertainties of the natural frequencies [Hz] and of the damping ratios [1], shape (m, 2);
        None where they are not known.
    """

    _uncertainties: Callable[[], Array] | None

    def __new__(cls, modes: Iterable[Mode], uncertainties: Callable[[], Array] | None = None) -> Self:
        """Keep what gives the uncertainties: modes are taken far more often than they are printed."""
        made = super().__new__(cls, modes)
        made._uncertainties = uncertainties
        return made

    @property
    def uncertainties(self) -> Array:
        """Standard uncertainties of the natural frequencies [Hz] and of the damping ratios [1], shape (m, 2)."""
        return np.zeros((len(self), 2)) if self._uncertainties is None else self._uncertainties()

    def __repr__(self) -> str:
        rows = (mode.told(float(row[0]), float(row[1])) for mode, row in zip(self, self.uncertainties, strict=True))
        return "\n  ".join([f"{len(self)} mode{'s' if len(self) != 1 else ''}", *rows])


def exponentials(pole: complex, time: ArrayLike) -> NDArray[np.complex128]:
    """Return exp(pole t) of times [s], shape (n,) [1]; 1 before time 0.

    Of evenly spaced times they are products of some 2 sqrt(n) exponentials, which takes a tenth of the time.
    """
    t = np.asarray(time, dtype=np.float64)
    if t.ndim != 1 or t.size < FEW:
        return np.asarray(np.exp(pole * np.maximum(t, 0.0)))
    begin = int(np.searchsorted(t, 0.0))
    count = t.size - begin
    out = np.ones(t.size, dtype=np.complex128)
    if not count:
        return out
    first, step = t[begin], (t[-1] - t[begin]) / max(count - 1, 1)
    even = first + step * np.arange(count)
    if float(np.abs(t[begin:] - even).max()) * abs(pole) > EVEN:
        return np.asarray(np.exp(pole * np.maximum(t, 0.0)))
    block = int(np.ceil(np.sqrt(count)))
    rows = np.exp(pole * (first + step * block * np.arange(-(-count // block))))
    out[begin:] = np.outer(rows, np.exp(pole * step * np.arange(block))).ravel()[:count]
    return out


class ModalModel(ABC):
    """One component's balance load under its force: a sum of modes.

    The shares of a steady load add to 1, so the first mode has what the further ones leave.

    Attributes
    ----------
    component
        Which component this is.
    further_modes
        The modes beside the first.
    """

    __slots__ = ()
    component: str
    further_modes: tuple[Mode, ...]

    @property
    @abstractmethod
    def natural_frequency(self) -> float:
        """Undamped natural frequency f0 of the first mode [Hz]."""

    @property
    @abstractmethod
    def damping_ratio(self) -> float:
        """Damping over critical damping of the first mode [1]."""

    @abstractmethod
    def with_modes(self, *further: Mode) -> Self:
        """The same model with these further modes, taken as known exactly."""

    @abstractmethod
    def retuned(self, *, frequency: float, damping: float) -> Self:
        """The same model with natural frequency and damping ratio of its first mode times these factors [1]."""

    @property
    def angular_frequency(self) -> float:
        """Undamped natural angular frequency w0 of the first mode [rad/s]."""
        return 2 * np.pi * self.natural_frequency

    @property
    def decay_rate(self) -> float:
        """Decay rate of a free oscillation in the first mode, zeta w0 [1/s]."""
        return self.damping_ratio * self.angular_frequency

    @property
    @abstractmethod
    def exact(self) -> Self:
        """The same model, taken as known exactly."""

    @property
    def quadratic(self) -> tuple[float, float]:
        """D [s] and A [s^2] of the first mode alone: F = AF + D AF' + A AF''."""
        return self.modes[0].quadratic

    @property
    def modes(self) -> Modes:
        """All modes, the first one first."""
        share = 1.0 - sum(mode.share for mode in self.further_modes)
        # a force changes the load's rate, not the load, at once: the rates that the modes show at first cancel
        at_once = sum(mode.rate_share * mode.natural_frequency**2 for mode in self.further_modes)
        rate_share = -at_once / self.natural_frequency**2
        first = Mode(self.natural_frequency, self.damping_ratio, share, rate_share)
        return Modes((first, *self.further_modes), self._mode_uncertainties)

    def _mode_uncertainties(self) -> Array:
        """Standard uncertainties of the frequencies [Hz] and damping ratios [1] of `modes`, shape (m, 2)."""
        return np.zeros((1 + len(self.further_modes), 2))

    def response(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Balance load over force applied, AF/F, at frequencies [Hz]; the transform of Eq. (8) with x1 at rest.

        The delay is not included.
        """
        s = 2j * np.pi * np.asarray(frequency)
        parts = ((mode.share + mode.rate_share * s) * mode.response(frequency) for mode in self.modes)
        return np.asarray(sum(parts), dtype=np.complex128)

    @property
    def polynomials(self) -> tuple[Array, Array]:
        """Numerator and denominator of AF/F by rising powers of s, of e + 1 modes: shapes (2e + 1,) and (2e + 3,)."""
        free = [np.array([1.0, *mode.quadratic]) for mode in self.modes]
        numerator = np.zeros(2 * len(free) - 1)
        for place, mode in enumerate(self.modes):
            rest = reduce(np.convolve, free[:place] + free[place + 1 :], np.array([mode.share, mode.rate_share]))
            numerator += rest[: numerator.size]
        return numerator, np.asarray(reduce(np.convolve, free))

    @property
    def poles(self) -> tuple[complex, complex]:
        """The two poles of Eq. (8) of [Gorbushin2020]_ [rad/s]; real when the damping ratio is above 1."""
        return self.modes[0].poles

    def free_decay(self, time: ArrayLike) -> Array:
        """Release from rest at time 0, over the load held before, Eq. (6) of [Gorbushin2020]_ [1].

        The sine term that (6) leaves out makes the velocity at release zero; with it the extrema of (7) are exact.
        It is 1 before the release.
        """
        return np.asarray(sum(mode.released(time) for mode in self.modes))

    def step_response(self, time: ArrayLike, *, duration: float = 0.0) -> Array:
        """Balance load after a force of 1 N is applied at time 0, at once or linearly over a duration.

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
        risen = sum(mode.risen(t) - mode.risen(late) for mode in self.modes)
        return np.asarray(risen / duration)

    def balance_load(self, net: Array, *, interval: float) -> Array:
        """Balance load under a net force that is linear between samples: Eq. (8) integrated exactly.

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


@dataclass(frozen=True, slots=True, eq=False)
class EquivalentModel(ModalModel):
    """The single-input model that reads as a decoupled channel does.

    Attributes
    ----------
    component
        Which component this is.
    first
        The first mode; its share of a steady load is what the further ones leave.
    further_modes
        The modes beside the first.
    """

    component: str
    first: Mode
    further_modes: tuple[Mode, ...] = ()

    @property
    def natural_frequency(self) -> float:
        """Undamped natural frequency f0 of the first mode [Hz]."""
        return self.first.natural_frequency

    @property
    def damping_ratio(self) -> float:
        """Damping over critical damping of the first mode [1]."""
        return self.first.damping_ratio

    def with_modes(self, *further: Mode) -> EquivalentModel:
        """The same model with these further modes."""
        return replace(self, further_modes=further)

    @property
    def exact(self) -> EquivalentModel:
        """The same model: its errors are those of the coupled dynamics that it comes from."""
        return self

    def retuned(self, *, frequency: float, damping: float) -> EquivalentModel:
        """The same model with natural frequency and damping ratio of its first mode times these factors [1]."""
        own = self.first
        return replace(self, first=Mode(own.natural_frequency * frequency, own.damping_ratio * damping))
