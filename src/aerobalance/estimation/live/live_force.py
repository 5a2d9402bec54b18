r"""The applied forces of n components (n >= 1) while the readings come in, the same however they come cut in blocks.

Eq. (17) of [Gorbushin2020]_ with matrices, F = X + D X' + A X'' - W + M x1''. The way of a block::

    block -> saturated readings become missing; a short gap is bridged by missing samples, a long one begins anew
          -> channels that lag each other are aligned           (alignment.Aligner)
          -> as many samples as the natural frequencies need     (decimation.Decimator)
          -> does the non-metric end move, and how?              (base_motion.LiveBaseMotion)
          -> the loads of that on the moving mass                (equation.Equation)
          -> each component by itself, those loads taken off     (decoupling.Decoupler)
          -> force by the smoother with a fixed lag              (component_smoother.ComponentSmoother)
          -> with the uncertainty of the dynamics, as soon as all components are final (pending.Pending)

No clock, no file, no thread. Learning takes longer than a sample may; with `LiveSettings.learn_inside` False,
`LiveForce.due` and `LiveForce.adopt` let the caller have it done elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.dynamics.decoupling import DecoupledChannel
from aerobalance.dynamics.independent import AnyDynamics, dynamics_of
from aerobalance.estimation.live.alignment import Aligner
from aerobalance.estimation.live.base_motion import LiveBaseMotion
from aerobalance.estimation.live.columns import Columns, judged_noise
from aerobalance.estimation.live.component_smoother import (
    FEWEST,
    ComponentSmoother,
    FinalSamples,
)
from aerobalance.estimation.live.decimation import Decimator
from aerobalance.estimation.live.decoupling import Decoupler
from aerobalance.estimation.live.equation import Equation
from aerobalance.estimation.live.health import Health, Learning, LiveEstimate, Snapshot
from aerobalance.estimation.live.pending import Pending
from aerobalance.estimation.live.platform import LiveChannel
from aerobalance.estimation.live.settings import LiveSettings
from aerobalance.estimation.observation import SpectralPrior
from aerobalance.estimation.steps import Step
from aerobalance.recording.blas_threads import one_blas_thread
from aerobalance.recording.channel import Array
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.errors import FitError

JUDGED: Final = 256
"""Readings that the covariance of their noise is judged from where it is not given."""


class LiveForce:
    """The applied forces of one component, or of several that are dynamically coupled, live.

    Parameters
    ----------
    dynamics
        Dynamics of one component, or of n coupled ones, with their covariance; or what `identify` returns.
    rate
        Sampling rate [Hz].
    channels
        The columns of the blocks, by name or with what is known of their sensors: every component, and what there is
        of ``pitch``, ``roll`` and sensors on the non-metric end. None for the columns of the first block.
    gravity
        Local acceleration of gravity [m/s^2].
    noise
        Covariance of the noise of a reading, shape (n, n) [N^2, N^2*m, N^2*m^2]; None to judge it from the first
        `JUDGED` samples. It decides how much a component leans on the readings of the others.
    learned
        Spectral prior by component, from an earlier record, its noise white; components without one begin with a wide
        band and learn from the readings.
    settings
        How the forces are worked out.

    Attributes
    ----------
    factor
        Readings that become one sample of the force.
    interval
        Time between samples of the force [s].
    generation
        Streams begun so far; what was learned of one that has ended serves the next at its start.

    Raises
    ------
    ValueError
        The rate is not positive, a component's channel is lacking, or the lag is too short.

    Examples
    --------
    >>> import numpy as np
    >>> from aerobalance.dynamics.single import Dynamics
    >>> from aerobalance.estimation.live.live_force import LiveForce
    >>> dynamics = Dynamics("AF", mass=177.87, stiffness=3.093e7, damping=828.21)
    >>> live = LiveForce(dynamics, rate=1600)
    >>> blocks = np.split(100 + np.random.default_rng(1).normal(size=1600), 16)
    >>> found = [live.push({"AF": block, "pitch": np.zeros(100)})["AF"].force for block in blocks]
    >>> round(float(np.concatenate(found)[-400:].mean()))
    100
    >>> round(live.lag, 3)  # five periods of the natural frequency [s]
    0.076
    """

    def __init__(
        self,
        dynamics: AnyDynamics,
        *,
        rate: float,
        channels: Sequence[LiveChannel | str] | None = None,
        gravity: float = STANDARD_GRAVITY,
        noise: Array | None = None,
        learned: Mapping[str, SpectralPrior] | None = None,
        settings: LiveSettings | None = None,
    ) -> None:
        if not 0 < rate < np.inf:
            raise ValueError(f"rate must be positive and finite [Hz], not {rate}")
        self.dynamics, self.rate, self.gravity = _block(dynamics_of(dynamics)), rate, gravity
        self.settings = settings or LiveSettings()
        self._equation = Equation.of(self.dynamics)
        self._frequencies = self.dynamics.leading_frequencies
        highest = max(self._frequencies, default=rate / 16)
        self.factor = max(1, int(rate / (self.settings.samples_a_period * highest)))
        self.interval = self.factor / rate
        n = len(self.components)
        self._weighs = noise is not None or n > 1  # of one alone there is nothing to weigh
        known = noise if self._weighs else np.eye(1)
        self._noise = self._given_noise = known
        self._learned = dict(learned or {})
        self.generation = 0
        self._columns: Columns | None = None
        self._expected: int | None = None
        self._last: Array = np.zeros(0)
        self._finished = False
        if channels is not None:
            self._set_up(channels)
        if self._noise is not None:
            self._smoothers(self._channels(self._noise), ahead=0)  # refuses what cannot be

    def __repr__(self) -> str:
        taken = f"{self._expected} readings taken" if self._expected else "no readings yet"
        lag = f", {self.lag:.2g} s behind them" if self.lag else ""
        return f"live force of {', '.join(self.components)} at {self.rate:.6g} Hz; {taken}{lag}"

    # ---- readings in, forces out

    @one_blas_thread()
    def push(self, block: ArrayLike | Mapping[str, ArrayLike], *, first: int | None = None) -> dict[str, LiveEstimate]:
        """Take a block of readings; return what has become final by it, the same samples of all components.

        Parameters
        ----------
        block
            Columns by name, shape (m,) each, or shape (m, c) in the order of `channels` (without them, of the
            components; (m,) for a single one), in SI units; NaN where a reading is missing.
        first
            Number of its first sample, counted from the first reading; None where it follows the last block. Fewer
            missing samples than the lag are bridged, more begin the stream anew.

        Raises
        ------
        ValueError
            The columns differ in length or from those before, the dynamics hold no mass and the non-metric end moves,
            or the stream is finished.
        """
        if self._finished:
            raise ValueError("the stream is finished; make a new LiveForce")
        rows = self._rows(block)
        expected, count = self._expected, rows.shape[0]
        start = (expected or 0) if first is None else first
        if expected is None or not 0 <= start - expected <= self._bridged:
            self._reset(start)
        elif start > expected:
            hole = np.repeat(self._last[None], start - expected, axis=0)
            hole[:, : len(self.components)] = np.nan
            rows = np.concatenate((hole, rows))
        self._expected = start + count
        if rows.shape[0]:
            self._last = np.asarray(rows[-1], dtype=np.float64)
            self._take(self._decimator.push(self._aligner.push(self._without_saturated(rows))))
        return self._found()

    @one_blas_thread()
    def finish(self) -> dict[str, LiveEstimate]:
        """End the stream; return the samples that were still waiting, by all readings.

        The last readings, as many as alignment and decimation reach over, get no force.
        """
        self._finished = True
        if self._expected is None:
            none = np.zeros(0)
            return {name: LiveEstimate(0, self.factor, 1 / self.rate, none, none, none) for name in self.components}
        if not self._running:
            self._begin()
            self._follow(self._waiting)
        self._drain()
        return self._found()

    def _drain(self) -> None:
        """Have all samples that still wait become final."""
        if self._parts is None and self._pushed >= FEWEST:  # of fewer there is neither a noise nor a force
            self._judge_noise()
        if self._decoupler is not None:
            self._smooth(self._decoupler.finish(), last=True)

    def restart(self) -> None:
        """Begin anew with the next reading, keeping what was learned: as where readings count from another zero."""
        if self._expected is not None:
            self._reset(self._expected)

    # ---- what is said of it

    @property
    def components(self) -> tuple[str, ...]:
        """Which components."""
        return self._equation.components

    @property
    def lag(self) -> float:
        """Time by which the force lags the readings [s]; 0 while it is not known."""
        if self._columns is None or self._parts is None:
            return 0.0
        waits = self._decimator.first + self._aligner.ahead
        return self._latency * self.interval + waits / self.rate

    @property
    def moving(self) -> bool:
        """Whether the non-metric end is taken to move."""
        return self._columns is not None and self._motion.moving

    @property
    def noise(self) -> Array | None:
        """Covariance of the noise of a reading, shape (n, n), as given or judged; None while it is not known."""
        return self._noise if self._weighs else None

    @property
    def steps(self) -> dict[str, tuple[Step, ...]]:
        """Steps of the forces that were found by component, instants since the stream began [s]."""
        return {name: part.steps for name, part in self._named_parts()}

    @property
    def health(self) -> dict[str, Health]:
        """State of health of the components; none before there is a force."""
        return {
            name: part.health(
                samples=self._samples, missing=int(self._missing[place]), saturated=int(self._saturated[place])
            )
            for place, (name, part) in enumerate(self._named_parts())
        }

    def _named_parts(self) -> list[tuple[str, ComponentSmoother]]:
        parts = None if self._columns is None else self._parts
        return [] if parts is None else list(zip(self.components, parts, strict=True))

    # ---- learning

    def due(self) -> Snapshot | None:
        """Return readings of a component from which it is time to learn, for `Snapshot.learn` elsewhere; None else."""
        for _, part in self._named_parts():
            snapshot = part.due()
            if snapshot is not None:
                return self._named(snapshot)
        return None

    def snapshot(self, component: str | None = None) -> Snapshot:
        """Return the last decoupled readings of a component, to learn from elsewhere.

        Raises
        ------
        FitError
            There are too few readings yet.
        """
        name = self.components[0] if component is None else component
        parts = dict(self._named_parts())
        if name not in parts:
            raise FitError(f"there are no readings of {name} yet; components: {', '.join(self.components)}")
        return self._named(parts[name].snapshot())

    def adopt(self, learning: Learning) -> None:
        """Go on with what was learned; it holds for all samples that are not final yet.

        What was learned of a stream that has ended serves the next start. Call it between two pushes.
        """
        self._learned[learning.component] = learning.learned
        if learning.generation == self.generation:
            dict(self._named_parts())[learning.component].adopt(learning)

    def _named(self, snapshot: Snapshot) -> Snapshot:
        return Snapshot(snapshot.reading, snapshot.first, self.generation)

    # ---- the columns

    def _set_up(self, channels: Sequence[LiveChannel | str]) -> None:
        given = [LiveChannel(one) if isinstance(one, str) else one for one in channels]
        self._columns = Columns.of(self.dynamics, given)
        self._reset(0)

    def _rows(self, block: ArrayLike | Mapping[str, ArrayLike]) -> Array:
        """Columns that are used, shape (m, ...): loads, sensors of the non-metric end, angles."""
        if self._columns is None:
            self._set_up(list(block) if isinstance(block, Mapping) else self.components)
        if self._columns is None:
            raise AssertionError
        return self._columns.readings(block)

    def _without_saturated(self, rows: Array) -> Array:
        """Count readings, and take those at a limit as missing."""
        columns = self._columns
        if columns is None:
            raise AssertionError
        loads = rows[:, : len(self.components)]
        present = np.isfinite(loads)
        at_limit = present & (np.abs(np.where(present, loads, 0.0)) >= columns.limits)
        self._samples += rows.shape[0]
        self._missing += np.count_nonzero(~present, axis=0)
        self._saturated += np.count_nonzero(at_limit, axis=0)
        if at_limit.any():
            rows = rows.copy()
            rows[:, : len(self.components)][at_limit] = np.nan
        return rows

    # ---- beginning, and beginning anew

    def _reset(self, first: int) -> None:
        """Begin with the sample of a number."""
        columns, n = self._columns, len(self.components)
        if columns is None:
            raise AssertionError
        width = len(columns.names)
        self._aligner = Aligner([late * self.rate for late in columns.late], loads=n)
        self._decimator = Decimator(width, self.factor)
        self._motion = LiveBaseMotion(
            columns, interval=self.interval, settings=self.settings.motion, gravity=self.gravity
        )
        self._origin, self._begun = first, 0
        self._waiting = np.empty((0, width))
        self._last = np.zeros(width)
        self._samples = 0
        self._missing, self._saturated = np.zeros((2, n), dtype=np.int64)
        self._out: list[tuple[int, Array, Array, Array]] = []
        self._forget_stream()

    def _forget_stream(self) -> None:
        self._running, self._pushed, self._latency = False, 0, 0
        self._parts: list[ComponentSmoother] | None = None
        self._decoupler: Decoupler | None = None
        self._early: list[tuple[Array, Array]] = []
        self._motion.forget()
        self.generation += 1

    def _begin_again(self) -> None:
        """Begin another stream with the next sample; what is not final by then has no force."""
        lost = self._pushed - self._pending.released
        if lost:
            nothing = np.full((lost, len(self.components)), np.nan)
            self._out.append((self._begun + self._pending.released, nothing, nothing, nothing))
        self._begun += self._pushed
        self._forget_stream()
        self._begin()

    def _begin(self) -> None:
        self._running = True
        self._pending = Pending(self._equation, interval=self.interval)
        if self._noise is not None:
            self._make()

    @property
    def _bridged(self) -> int:
        """Longest gap that is bridged, in readings."""
        return self._latency * self.factor if self._running else 0

    def _make(self) -> Decoupler:
        """The decoupled channels and their smoothers, now that the noise is known."""
        columns = self._columns
        if columns is None or self._noise is None:
            raise AssertionError
        channels = self._channels(self._noise)
        self._decoupler = Decoupler(
            channels, interval=self.interval, moves=self._motion.follows, delay=self._equation.delay
        )
        self._parts = self._smoothers(channels, ahead=self._decoupler.ahead)
        self._latency = self._decoupler.ahead + max(part.settings.lag for part in self._parts)
        return self._decoupler

    def _channels(self, noise: Array) -> list[DecoupledChannel]:
        return [self.dynamics.decoupled(name, noise=noise) for name in self.components]

    def _smoothers(self, channels: Sequence[DecoupledChannel], *, ahead: int) -> list[ComponentSmoother]:
        covariance = np.zeros((6, 6)) if self._columns is None else self._motion.covariance()
        made = []
        for row, name, channel in zip(self._equation.mass, self.components, channels, strict=True):
            chosen = self.settings.of_channel(
                channel,
                interval=self.interval,
                ahead=ahead,
                modes=self._frequencies,
                learned=self._learned.get(name),
                input_noise=float(max(row @ covariance @ row, 0.0)) * self.interval,
            )
            made.append(ComponentSmoother(channel.dynamics, chosen))
        return made

    # ---- from samples to forces

    def _take(self, rows: Array) -> None:
        """Take decimated samples, up to the next look at the motion at a time."""
        motion = self._motion
        while rows.shape[0]:
            count = motion.room(rows.shape[0])
            part, rows = rows[:count], rows[count:]
            looked, changed = motion.watch(part)
            if not self._running:
                self._waiting = np.concatenate((self._waiting, part))
                if motion.watched and not looked:
                    return
                part, self._waiting = self._waiting, self._waiting[:0]
                self._begin()
                changed = False
            self._follow(part)
            if changed:
                self._drain()
                self._begin_again()

    def _follow(self, rows: Array) -> None:
        """Work out forces from samples; where no filter can follow them, begin anew without what was learned."""
        self._pushed += rows.shape[0]
        try:
            self._estimate(rows)
        except (ArithmeticError, np.linalg.LinAlgError, FitError):
            self._learned, self._noise = {}, self._given_noise
            self._begin_again()

    def _estimate(self, rows: Array) -> None:
        loads = rows[:, : len(self.components)]
        force, turn_rate = self._motion.at(rows)
        net = self._equation.net_load(force, turn_rate)
        self._pending.push(loads, net, force)
        if self._decoupler is None:
            self._early.append((loads, net))
            if self._pushed >= JUDGED:
                self._judge_noise()
        else:
            self._smooth(self._decoupler.push(loads, net))

    def _judge_noise(self) -> None:
        """Judge the noise from the first samples, and go on with all that are there."""
        loads, net = (np.concatenate([part[which] for part in self._early]) for which in (0, 1))
        self._early = []
        self._noise = judged_noise(self.components, loads[:JUDGED])
        self._smooth(self._make().push(loads, net))

    def _smooth(self, readings: Array, *, last: bool = False) -> None:
        for place, part in enumerate(self._parts or ()):
            final: FinalSamples = part.push(np.ascontiguousarray(readings[:, place]), last=last)
            self._pending.take(place, final)
        first, force, variance, loads = self._pending.release()
        if force.shape[0]:
            self._out.append((self._begun + first, force, np.sqrt(variance), loads))

    def _found(self) -> dict[str, LiveEstimate]:
        """What has become final since the last time."""
        parts, self._out = self._out, []
        n = len(self.components)
        number = self._begun
        if parts:
            number = parts[0][0]
        elif self._running:
            number = self._begun + self._pending.released
        force, deviation, loads = (
            np.concatenate([np.zeros((0, n)), *(part[which] for part in parts)]) for which in (1, 2, 3)
        )
        first = self._origin + self._decimator.first + number * self.factor
        return {
            name: LiveEstimate(
                first, self.factor, 1 / self.rate, force[:, place], deviation[:, place], loads[:, place]
            )
            for place, name in enumerate(self.components)
        }


def _block(dynamics: BalanceDynamics) -> BalanceDynamics:
    """Dynamics whose forces follow each other together."""
    if len(dynamics.blocks) > 1:
        raise ValueError(f"{', '.join(dynamics.components)} are not coupled: each needs a live force of its own")
    return dynamics
