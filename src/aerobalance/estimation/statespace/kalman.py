r"""The optimal estimator: the applied force as an unknown input of the balance, given all readings.

The balance is Eq. (8) of [Gorbushin2020]_, once for each mode; the force is a stationary process of a given spectrum,
made from white noise by a shaping filter, plus a constant and steps. Everything is discretised exactly, so with noise
going to zero the estimate goes to Eq. (17).

References
----------
.. [VanLoan1978] C. F. Van Loan, "Computing integrals involving the matrix exponential", IEEE Trans. Automat. Control
   23 (1978) 395.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_continuous_lyapunov

from aerobalance.dynamics.modal import ModalModel, Mode
from aerobalance.estimation.statespace import _kernels
from aerobalance.estimation.statespace.blocks import BLOCK, BlockForms, OutputForms
from aerobalance.estimation.statespace.shaping_filter import ShapingFilter
from aerobalance.estimation.statespace.smoothed_variance import gap_before, smoothed_variance
from aerobalance.estimation.statespace.steady_run import SteadyRun, Weighed
from aerobalance.estimation.statespace.steady_state import SteadyState
from aerobalance.estimation.statespace.stretches import Planner, Stretch
from aerobalance.recording.channel import Array

SURE: Final = 1e-6
"""Change of what is found of a state, over its standard deviation, that makes no difference; in a series that shows
less than that deviation, over what it shows."""

CLEAR: Final = 1e4
"""How much more than their noise readings may show of a state before rounding makes it less than exact."""

PASSES: Final = 4
"""Times that such a state is found again."""

NOTHING: Final = 1e-9
"""Standard deviation of a part of the initial state in whitened readings, below which it shows nothing [1]."""

AT_ONCE: Final = 1 << 17
"""Samples of all series together that are whitened at once, or one series."""

LOAD, LOAD_RATE, FORCE = 0, 1, 2
"""Places in the state: the balance load AF, its rate AF'/w0, and the force F, the first state of its shaping filter.

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

    def __eq__(self, other: object) -> bool:
        return isinstance(other, StateSpace) and self._numbers == other._numbers

    def __hash__(self) -> int:
        return hash(self._numbers)

    @property
    def _numbers(self) -> tuple[object, ...]:
        matrices = (self.transition, self.process_noise, self.initial)
        return (*(matrix.tobytes() for matrix in matrices), self.noise_variance, self.colors)

    @property
    def observation(self) -> Array:
        """Row h that turns the state into the reading, shape (d,)."""
        row = np.zeros(self.transition.shape[0])
        row[[LOAD, *self.colors]] = 1.0
        return row


@lru_cache(maxsize=16)  # a search for steps and the checks after it come back to the filters that they have had
def _steady_forms(system: StateSpace) -> BlockForms:
    return BlockForms.of(SteadyState.of(system.model, system.initial))


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
    """The Kalman filter of a state space and its fixed-interval smoother, for the samples that are present.

    The gain is the steady one throughout; start and gaps are taken into account beside it (`stretches`), exactly.

    Attributes
    ----------
    system
        The state space.
    present
        False where an observation is missing, shape (n,).
    planner
        What knows the steady filter.
    forms
        What runs it along a series.
    stretches
        The samples between gaps.
    """

    system: StateSpace
    present: NDArray[np.bool_]
    planner: Planner
    forms: BlockForms
    stretches: tuple[Stretch, ...]

    @classmethod
    def of(cls, system: StateSpace, present: NDArray[np.bool_]) -> KalmanFilter:
        """Return the filter of a state space for these samples."""
        forms = _steady_forms(system)
        planner = Planner(forms.steady, forms.steady.initial)
        return cls(system, present, planner, forms, planner.stretches(present))

    @property
    def settled(self) -> KalmanFilter:
        """The filter as it is long after the start, when it has forgotten the initial state, without gaps."""
        present = np.ones_like(self.present)
        planner = Planner(self.forms.steady, self.forms.steady.covariance)
        return replace(self, present=present, planner=planner, stretches=planner.stretches(present))

    def over(self, present: NDArray[np.bool_]) -> KalmanFilter:
        """Return the same filter for other samples, such as a part of the record, from the same initial state."""
        return replace(self, present=present, stretches=self.planner.stretches(present))

    @property
    def has_no_gaps(self) -> bool:
        """Whether all samples are present."""
        (first, *others) = self.stretches
        return not others and first.first == 0 and first.stop == self.present.size

    @property
    def start_shown(self) -> tuple[Array, Array]:
        """What the initial state beyond the steady one shows in the innovations, by their standard deviation.

        Returns
        -------
        shapes, seen
            Orthogonal shapes of length 1, shape (r, m), and standard deviations of their sizes, shape (r,) [1].
        """
        one = self.stretches[0]
        seen = one.seen[one.seen > NOTHING] if one.memory else np.zeros(0)
        shown = self.forms.released(one.start.T[one.seen > NOTHING], one.memory)[1] if seen.size else np.zeros((0, 0))
        return shown / (seen[:, None] * np.sqrt(self.forms.steady.variance)), seen

    @property
    def log_determinant(self) -> float:
        """Sum over the present samples of the logarithm of the innovation variance."""
        steady = np.count_nonzero(self.present) * np.log(self.forms.steady.variance)
        return float(steady + sum(np.sum(np.log1p(one.seen**2)) for one in self.stretches))

    def whiten(self, series: Array) -> Array:
        """Return several series (n, c) such that observations become white with variance 1, shape (n, c) [1].

        These are innovations over their standard deviation, at the start and after gaps in an order of their own; 0
        where an observation is missing. Some series at a time: the filter takes several times their memory.
        """
        out = np.zeros(series.shape[::-1])
        some = max(AT_ONCE // max(series.shape[0], 1), 1)
        for first in range(0, series.shape[1], some):
            self._whiten(series[:, first : first + some], out[first : first + some])
        return out.T

    def _whiten(self, series: Array, out: Array) -> None:
        """Write several series (n, c) such that observations become white with variance 1, shape (c, n) [1]."""
        forms = self.forms
        for run in self._forward(series, innovations=True):
            one, innovations = run.stretch, run.innovations
            if one.memory:
                # 1 - Z Z' / (1 + Z' Z), the inverse of what c does to white noise, is the square of 1 - Z b Z'
                power = np.maximum(one.seen, 1e-30) ** 2
                half = -np.expm1(-0.5 * np.log1p(power)) * (1 + power) / power
                innovations[:, : one.memory] -= forms.released((run.numbers * (half - 1)) @ one.start.T, one.memory)[1]
            out[:, one.first : one.stop] = innovations
        out /= np.sqrt(forms.steady.variance)

    @property
    def shown(self) -> int:
        """How many numbers `smooth` shows of a series."""
        return self.present.size + sum(one.seen.size for one in self.stretches)

    def smooth(
        self, series: Array, wanted: Sequence[int] = (LOAD, LOAD_RATE, FORCE), *, shown: Array | None = None
    ) -> Array:
        """Return the wanted states of several series (n, c) given all observations, shape (n, c, w).

        Innovations over their standard deviation, and after them the numbers c, go to `shown`, where that is given,
        shape (c, `self.shown`): products of two series, summed, are those of the whitened ones, at no cost.
        """
        runs = list(self._forward(series, innovations=shown is not None))
        if shown is not None:
            shown[:] = 0.0
            place = self.present.size
            for run in runs:
                own = slice(run.stretch.first, run.stretch.stop)
                shown[:, own] = run.innovations / np.sqrt(self.forms.steady.variance)
                shown[:, place : place + run.numbers.shape[1]] = run.numbers
                place += run.numbers.shape[1]
        return self._backward(runs, series.shape, wanted)

    def weighed(self, weights: Array) -> tuple[Weighed, ...]:
        """Return what makes sums, of these weights, of what `smooth` shows of a series; shape (p, `self.shown`)."""
        place, found = self.present.size, []
        for one in self.stretches:
            own = weights[:, one.first : one.stop] / np.sqrt(self.forms.steady.variance)
            found.append(Weighed(*self.forms.weighed(own), weights[:, place : place + one.seen.size]))
            place += one.seen.size
        return tuple(found)

    def smooth_and_sum(self, series: Array, wanted: Sequence[int], weights: Sequence[Weighed]) -> tuple[Array, Array]:
        """Return what `smooth` does, shape (n, c, w), and sums of what it shows of the series, shape (p, c).

        Innovations are not worked out, which takes a third of the time.

        Parameters
        ----------
        series, wanted
            As of `smooth`.
        weights
            What `weighed` makes of the weights of the sums.
        """
        runs = list(self._forward(series, innovations=False))
        sums = [weight.sums(run) for weight, run in zip(weights, runs, strict=True)]
        return self._backward(runs, series.shape, wanted), np.sum(sums, axis=0)

    def _backward(self, runs: Sequence[SteadyRun], shape: tuple[int, ...], wanted: Sequence[int]) -> Array:
        """Return the wanted states of series of a shape (n, c) that the filter has run along, shape (n, c, w)."""
        forms = self.forms
        rows = forms.steady.basis[list(wanted)]
        outputs = [forms.output(row) for row in rows]
        out = np.empty((len(wanted), *shape[::-1]))
        last = np.zeros((shape[1], forms.steady.entry.size))
        for run in reversed(runs):
            one = run.stretch
            if one.first < one.stop:
                last = self._smoothed(run, last, outputs=outputs, out=out[:, :, one.first : one.stop])
            if one.gap_length:
                gap = gap_before(one, forms.steady)
                for place, row in enumerate(rows):
                    mean = gap.mean(row, run.before)
                    out[place, :, one.gap : one.first] = mean + gap.told_later(gap.covariance_rows(row), last)
                last = gap.before(last)
        return np.transpose(out)

    def _smoothed(self, run: SteadyRun, last: Array, *, outputs: Sequence[OutputForms], out: Array) -> Array:
        """Write the wanted states (w, c, m) of a stretch; from the adjoint states after it (c, d) those before it."""
        forms, one = self.forms, run.stretch
        adjoint = forms.adjoint_of(run.series, run.states, last)
        if one.memory:
            edge = one.memory // BLOCK
            after = last if one.memory == run.series.shape[1] else adjoint[:, edge]
            clear = not one.end.size and np.max(one.seen) <= CLEAR
            if not clear and self._tell(run, after, start=adjoint[:, 0]):
                adjoint[:, : edge + 1] = forms.adjoint(run.innovations[:, : one.memory], after)
        for output, place in zip(outputs, out, strict=True):
            output.write(place, run.series, run.states, adjoint, last=last)
        before = adjoint[:, 0]
        if one.memory and one.gap_length:
            # c is what is told of it exactly, so that a gap before is not filled with what rounding makes of that
            seen = self.planner.seen_by(one.memory, np.eye(before.shape[1]))
            left = (before @ one.start - run.numbers) / (1 + one.seen**2)
            before = before - left @ (seen @ one.start).T @ seen
        return before

    @property
    def smoothed_variance(self) -> Array:
        """Variance of the force given all observations, shape (n,) [N^2]."""
        return smoothed_variance(self.forms, self.planner, self.stretches, row=self.forms.steady.basis[FORCE])

    def _forward(self, series: Array, *, innovations: bool) -> Iterator[SteadyRun]:
        """Run the filter along several series (n, c), each from a zero state; with all innovations or the first."""
        forms, A = self.forms, self.forms.steady.model.A
        whole = np.ascontiguousarray(series.T)
        mean = np.zeros((whole.shape[0], A.shape[0]))
        for one in self.stretches:
            before = mean
            first = before @ np.linalg.matrix_power(A, one.gap_length).T if one.gap_length else before
            part = whole[:, one.first : one.stop]
            states, mean = forms.states(part, first)
            numbers = np.zeros((whole.shape[0], one.seen.size))
            some = part.shape[1] if innovations else one.memory
            early = forms.innovations(part[:, :some], states[:, : some // BLOCK + 1])
            run = SteadyRun(one, before, part, first, states, early, numbers)
            if one.memory:
                self._tell(run, np.zeros_like(first))
                if one.end.size:
                    mean = forms.states(part, first + run.numbers @ one.start.T)[1]
            yield run

    def _tell(self, run: SteadyRun, after: Array, *, start: Array | None = None) -> bool:
        """Find the numbers c of a stretch, given adjoint states (c, d) after its memory; return whether they changed.

        The rest of the run goes with them. The first answer is as wrong as rounding of innovations without it, so it
        is found again from those with it. The adjoint states before the stretch are taken if they are known.
        """
        forms, one = self.forms, run.stretch
        early, edge = run.innovations[:, : one.memory], one.memory // BLOCK
        power, changed = 1 + one.seen**2, False
        # a known shape is to be as exact as it is large, as nobody knows here how large it is in the readings
        shows = np.linalg.norm(early, axis=1) / np.sqrt(forms.steady.variance)
        least = SURE * np.minimum(shows, 1.0)[:, None]
        for _ in range(PASSES if np.max(one.seen) > CLEAR else 1):
            before = forms.adjoint(early, after)[:, 0] if start is None else start
            change = (before @ one.start - run.numbers) / power
            if not (np.abs(change) * np.sqrt(power) > least).any():
                break
            run.numbers[:] += change
            states, shown = forms.released(change @ one.start.T, one.memory)
            run.states[:, : edge + 1] += states
            early -= shown
            start, changed = None, True
        return changed
