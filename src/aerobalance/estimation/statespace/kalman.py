r"""The optimal estimator: the applied force as an unknown input of the balance, given all readings.

The balance is Eq. (8) of [Gorbushin2020]_, once for each mode; the force is a stationary process of a given spectrum,
made from white noise by a shaping filter, plus a constant and steps. Everything is discretised exactly, so with noise
going to zero the estimate goes to Eq. (17).

References
----------
.. [deJong1989] P. de Jong, "Smoothing and interpolation with the state-space model", J. Amer. Statist. Assoc. 84
   (1989) 1085.
.. [VanLoan1978] C. F. Van Loan, "Computing integrals involving the matrix exponential", IEEE Trans. Automat. Control
   23 (1978) 395.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_continuous_lyapunov

from aerobalance.dynamics.modal import ModalModel, Mode
from aerobalance.estimation.statespace import _kernels
from aerobalance.estimation.statespace.shaping_filter import ShapingFilter
from aerobalance.recording.channel import Array

GAIN_TOLERANCE: Final = 1e-8
"""Relative change of the covariance in one sample below which the filter's gain is frozen."""

LOAD, LOAD_RATE, FORCE = 0, 1, 2
"""Places in the state: the load felt AF, its rate AF'/w0, and the force F, the first state of its shaping filter.

The further modes q and their rates q'/w come next, and the states of colored noise last."""


@dataclass(frozen=True, slots=True, eq=False)
class StateSpace:
    """The reading of one component over one sampling interval, as a linear system driven by white noise.

    Attributes
    ----------
    transition, process_noise
        State transition and covariance of the noise that enters over one interval, shape (d, d).
    initial
        Covariance of the first state, shape (d, d).
    noise_variance
        Variance of the white noise of a reading [N^2].
    colors
        Places of the states that colored noise adds to a reading.
    """

    transition: Array
    process_noise: Array
    initial: Array
    noise_variance: float
    colors: tuple[int, ...] = field(default=())

    @classmethod
    def of_balance(
        cls,
        dynamics: ModalModel,
        force: ShapingFilter,
        *,
        interval: float,
        noise: float,
        input_density: float = 0.0,
        swing: float = 0.0,
        colors: Sequence[ShapingFilter] = (),
    ) -> StateSpace:
        """Join the balance, Eq. (8) of [Gorbushin2020]_, with the process that the force is taken for.

        Parameters
        ----------
        dynamics
            Mass, stiffness and damping, and further modes.
        force
            What makes the force out of white noise.
        interval
            Time between samples [s].
        noise
            Standard deviation of the white noise of a reading [N].
        input_density
            Two-sided density of the white noise which enters as a force with known inputs, such as (M u(x1''))^2
            times the interval [N^2/Hz].
        swing
            Size of a free oscillation that may be under way when the record starts [N].
        colors
            What makes the further noise of a reading, process by process, out of white noise.
        """
        first, *further = dynamics.modes
        w0 = first.angular_frequency
        balance = FORCE + force.order + 2 * len(further)
        size = balance + sum(color.order for color in colors)
        A = np.zeros((size, size))
        B = np.zeros((size, 2 + len(colors)))
        A[LOAD, LOAD_RATE] = w0
        A[LOAD_RATE, [LOAD, LOAD_RATE, FORCE]] = -w0, -2 * first.damping_ratio * w0, first.share * w0
        A[FORCE : FORCE + force.order, FORCE : FORCE + force.order] = force.drift
        B[FORCE : FORCE + force.order, 1] = force.drive
        for number, mode in enumerate(further):
            # the first mode is the load less the other ones, so that the load itself stays the first state
            q, rate = FORCE + force.order + 2 * number, FORCE + force.order + 2 * number + 1
            w = mode.angular_frequency
            A[q, rate] = w
            A[rate, [q, rate, FORCE]] = -w, -2 * mode.damping_ratio * w, w
            by_load, by_rate, by_force = _beside(first, mode)
            A[LOAD_RATE, [q, rate]] = w0 * by_load, w0 * w * by_rate
            A[LOAD_RATE, FORCE] += w0 * by_force
            B[rate, 0] = w * np.sqrt(input_density)
        B[LOAD_RATE, 0] = A[LOAD_RATE, FORCE] * np.sqrt(input_density)
        places = balance + np.cumsum([0, *(color.order for color in colors)], dtype=int)
        for number, (color, first_place) in enumerate(zip(colors, places[:-1], strict=True), 2):
            part = slice(first_place, first_place + color.order)
            A[part, part] = color.drift
            B[part, number] = color.drive
        transition, process_noise = _discretise(A, B @ B.T, interval)
        initial = solve_continuous_lyapunov(A, -B @ B.T)
        initial = (initial + initial.T) / 2
        initial[[LOAD, LOAD_RATE], [LOAD, LOAD_RATE]] += swing**2
        for number, mode in enumerate(further):
            pair = [FORCE + force.order + 2 * number, FORCE + force.order + 2 * number + 1]
            initial[pair, pair] += (swing * _reach(mode)) ** 2
        return cls(transition, process_noise, initial, noise**2, tuple(int(place) for place in places[:-1]))

    @property
    def model(self) -> _kernels.Model:
        """What the compiled loops take."""
        A = np.ascontiguousarray(self.transition)
        Q = np.ascontiguousarray(self.process_noise)
        return _kernels.Model(A, np.ascontiguousarray(A.T), Q, self.observation, self.noise_variance)

    @property
    def observation(self) -> Array:
        """Row h that turns the state into the reading, shape (d,)."""
        row = np.zeros(self.transition.shape[0])
        row[[LOAD, *self.colors]] = 1.0
        return row


def _reach(mode: Mode) -> float:
    """How far a further mode may swing at first, over what the load may.

    A mode of one component follows the force, so it swings as far as the readings. One of several components may have
    whatever state makes the load go on as it does from the readings before, in which others have a part.
    """
    if not mode.rate_share:
        return 1.0
    return 1 / float(np.hypot(mode.share, mode.angular_frequency * mode.rate_share))


def _beside(first: Mode, mode: Mode) -> tuple[float, float, float]:
    r"""What drives the load, over w0^2, where a further mode is beside the first: by its response, rate, and force.

    With 1 + d s + a s^2 of the two, (share + rate_share s) (1 + d0 s + a0 s^2) / (1 + d s + a s^2) is the force's
    factor g0 + g1 s and (h0 + h1 s) times the mode; all g1 together are zero, as the load does not follow at once.
    """
    (d0, a0), (d, a) = (
        (2 * one.damping_ratio / one.angular_frequency, one.angular_frequency**-2) for one in (first, mode)
    )
    g1 = mode.rate_share * a0 / a
    g0 = (mode.share * a0 + mode.rate_share * d0 - g1 * d) / a
    return mode.share - g0, mode.share * d0 + mode.rate_share - g0 * d - g1, g0


def _discretise(A: Array, intensity: Array, interval: float) -> tuple[Array, Array]:
    """Transition and noise covariance of x' = A x + white noise over an interval, exactly [VanLoan1978]_.

    Worked out over a part of the interval that is short for the fastest state, then doubled: a sum of positive terms,
    where the exponential over the whole interval would grow beyond all bounds.
    """
    size = A.shape[0]
    doublings = max(0, int(np.ceil(np.log2(np.linalg.norm(A, 1) * interval + 1e-300))))
    block = np.zeros((2 * size, 2 * size))
    block[:size, :size] = -A
    block[:size, size:] = intensity
    block[size:, size:] = A.T
    exponential = expm(block * (interval / 2**doublings))
    transition = np.ascontiguousarray(exponential[size:, size:].T)
    noise = transition @ exponential[:size, size:]
    for _ in range(doublings):
        noise = noise + transition @ noise @ transition.T
        transition = transition @ transition
    return transition, np.ascontiguousarray((noise + noise.T) / 2)


@dataclass(frozen=True, slots=True, eq=False)
class KalmanFilter:
    """A state space and the gains of its Kalman filter for the samples that are present.

    Attributes
    ----------
    system
        The state space.
    present
        False where an observation is missing, shape (n,).
    gains
        Gain and innovation variance of each sample, and the rows of load, load rate and force of its covariance.
    """

    system: StateSpace
    present: NDArray[np.bool_]
    gains: _kernels.Gains

    @classmethod
    def of(cls, system: StateSpace, present: NDArray[np.bool_]) -> KalmanFilter:
        """Return the filter of a state space, its gains computed for these samples."""
        row, P, K, S = _kernels.gains(present, system.model, system.initial, FORCE + 1, GAIN_TOLERANCE)
        return cls(system, present, _kernels.Gains(row, P.reshape(S.size, FORCE + 1, -1), K, S[:, 0]))

    def filter(self, series: Array, wanted: Sequence[int] = ()) -> tuple[Array, Array]:
        """Return predictions (n, c, w) of the wanted states and innovations (n, c) of several series at once.

        Each series (n, c) starts from a zero state; an innovation is 0 where an observation is missing.
        """
        places = np.array(wanted, dtype=np.int64)
        return _kernels.filtered(np.ascontiguousarray(series), self.present, self.system.model, self.gains, places)

    def whiten(self, series: Array) -> Array:
        """Return innovations over their standard deviation, of several series at once, shape (n, c) [1].

        Observations become white with variance 1 if the model is right.
        """
        _, innovations = self.filter(series)
        return innovations / np.sqrt(self.gains.S[self.gains.row])[:, None]

    @property
    def settled(self) -> KalmanFilter:
        """The filter as it is long after the start, when it has forgotten the initial state."""
        last = np.full_like(self.gains.row, self.gains.S.size - 1)
        return replace(self, gains=self.gains._replace(row=last), present=np.ones_like(self.present))

    @property
    def log_determinant(self) -> float:
        """Sum over the present samples of the logarithm of the innovation variance."""
        return float(np.sum(np.log(self.gains.S[self.gains.row[self.present]])))

    def smooth(self, series: Array, wanted: Sequence[int] = (LOAD, LOAD_RATE, FORCE)) -> Array:
        """Return the wanted states of several series (n, c) given all observations, shape (n, c, w) [deJong1989]_.

        The wanted states are among load, load rate and force.
        """
        states, innovations = self.filter(series, wanted)
        places = np.array(wanted, dtype=np.int64)
        _kernels.smooth(states, innovations, self.present, self.system.model, self.gains, places)
        return states

    @property
    def smoothed_variance(self) -> Array:
        """Variance of the force given all observations, shape (n,) [N^2]."""
        return _kernels.smoothed_variance(self.present, self.system.model, self.gains, FORCE, GAIN_TOLERANCE)
