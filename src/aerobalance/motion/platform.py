"""What the ground end does in six degrees of freedom, and the loads that this puts on the moving mass."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.motion.assumptions import check_roll, taken_as_zero
from aerobalance.motion.at_rest import AT_REST, tones
from aerobalance.motion.attitude import Attitude
from aerobalance.motion.consistency import Effect, check_agreement
from aerobalance.motion.gaps import GAP
from aerobalance.motion.least_squares import GroundFit
from aerobalance.motion.rotation import Turning, turned_by
from aerobalance.motion.sensors import driving_sensors, ground_sensors, motion_name
from aerobalance.recording.channel import Array
from aerobalance.recording.components import (
    AXES,
    COMPONENTS,
    DIRECTIONS,
    FORCE_ROWS,
    IS_FORCE,
    MOMENT_ROWS,
    MOMENTS,
    STANDARD_GRAVITY,
    acceleration_name,
    driving_axis,
)
from aerobalance.recording.gravity import Gravity
from aerobalance.recording.recording import Recording
from aerobalance.recording.resampling import held_by_delays
from aerobalance.recording.sensors import corrected

GAINS: Final = ("accelerometer gain", "turn sensor gain")
"""Names of what is not known of the sensors' gains."""

UNRECORDED: Final = "weight that turns with unrecorded "
"""Name of what turns change of the weight where no angle is recorded, before the angle."""

TURNS: Final = "turns along "
"""Name of its source, before the component."""

TURNING: Final = "w x (w x r) by integrated turns"
"""Name of what is not known of the rate of turn."""

ROUNDING: Final = 1e-9
"""Share of a sensor in a motion, over the largest, up to which it has none."""

FEWEST: Final = 64
"""Samples from which it can be told that a motion shows nothing beyond its noise: they tell its variance to 18 %."""


@dataclass(frozen=True, slots=True, eq=False)
class SystematicParameter:
    """A number behind the ground's motion that holds along the record and is not known exactly.

    Attributes
    ----------
    name
        What it is.
    source
        Channel, or setting, that it comes from.
    slope
        Change of the specific force with it, of its shape [m/s^2 per its unit; rad/s^2 in turns].
    uncertainty
        Its standard uncertainty.
    local
        Whether it belongs to this part of a record alone, as what a gap hides does.
    """

    name: str
    source: str
    slope: Array
    uncertainty: float
    local: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class PlatformMotion:
    """Motion of the ground end in six degrees of freedom, in the order and signs of the components.

    NF, SF and AF are the acceleration of the balance's centre up, to the right and aft; PM, YM and RM the angular
    acceleration nose up, nose right and right side down.

    Attributes
    ----------
    acceleration
        Shape (n, 6) [m/s^2, rad/s^2].
    covariance
        Covariance of the noise of one of its samples with that of gravity, shape (6, 6).
    white_covariance
        The same of a white noise that is as strong as that noise is where its power is: what comes from a rate of
        turn grows with frequency up to where the rate is used.
    specific_force
        The acceleration less gravity, shape (n, 6) [m/s^2, rad/s^2]; gravity is in the straight ones only.
    turn_rate
        Rate of turn in the signs of PM, YM and RM, shape (n, 3) [rad/s].
    delay
        Time by which it lags the clock [s].
    assumptions
        What had to be taken as zero because no sensor sees it, and the like.
    unknowns
        What holds along the record and is not known exactly: gain, zero and place of the sensors, zero and gain of
        the angles, and gravity, these less what they do in the zero of the loads; slopes have shape (n, 6).
    gravity_on_zero
        Gravity at the zero of the recording's loads, shape (6,) [m/s^2].
    delays
        Times by which its sensors, and the angles that move, lag the clock [s].
    """

    acceleration: Array
    covariance: Array
    white_covariance: Array
    specific_force: Array
    turn_rate: Array
    delay: float
    assumptions: tuple[str, ...]
    unknowns: tuple[SystematicParameter, ...] = ()
    gravity_on_zero: Array = field(default_factory=lambda: np.zeros(len(COMPONENTS)))
    delays: tuple[float, ...] = ()

    @classmethod
    def of(
        cls,
        recording: Recording,
        *,
        along: str | None = None,
        gravity: float = STANDARD_GRAVITY,
        gravity_uncertainty: float = 0.0,
    ) -> PlatformMotion:
        """Take the motion from a recording's accelerometers, turns, rates of turn, pitch and roll.

        Channels ``ground_acceleration`` with any ending are accelerometers; ``ground_turn_PM`` and
        ``ground_turn_rate_PM`` and their like are angular acceleration and rate of turn. A motion that shows nothing
        beyond its noise is taken as zero, but for tones. Readings that do not agree with each other are warned of.

        Parameters
        ----------
        recording
            What was recorded.
        along
            A component that is not coupled with others: only the accelerometer along it is used. None for all.
        gravity, gravity_uncertainty
            Local acceleration of gravity and its standard uncertainty [m/s^2].

        Raises
        ------
        FitError
            An accelerometer has no axis, or a channel no reading.
        """
        record = MotionRecord.of(corrected(recording), along=along, gravity=gravity)
        return record.solved(gravity_uncertainty)

    def moved(self, changes: Array) -> PlatformMotion:
        """The motion, its specific force at least, if the `unknowns` were off by so much, shape (their number,)."""
        change = sum((item.slope * by for item, by in zip(self.unknowns, changes, strict=True)), np.zeros(6))
        return replace(self, specific_force=self.specific_force + change)

    def force(self, mass: RigidMass) -> Array:
        """Loads on the moving mass in the frame of the ground end: W - M x1'', less what keeps the mass turning.

        Parameters
        ----------
        mass
            The moving mass, about the balance's centre.

        Returns
        -------
        force
            Shape (n, 6) [N, N*m].
        """
        return -self.specific_force @ mass.matrix.T - mass.turning_load(self.turn_rate)

    def unread_at(self, delay: float, *, interval: float) -> NDArray[np.bool_]:
        """Where a load that lags the clock by a delay [s] was read while a sensor of a moving ground was not, (n,)."""
        return unread_beside(self.specific_force, self.delays, delay=delay, interval=interval)


def unread_beside(motion: Array, delays: Sequence[float], *, delay: float, interval: float) -> NDArray[np.bool_]:
    """Where a series that lags the clock by a delay [s] was read while one that makes up a motion was not, shape (n,).

    A motion that is constant, shape (n,) or (n, c), is known where nothing was read as well.
    """
    lags = [delay - own for own in delays] if (motion != motion[:1]).any() else []
    return held_by_delays(len(motion), delays=lags, interval=interval)


def driven_column(component: str) -> int:
    """Return the place among the components of the motion that drives a component taken alone."""
    return FORCE_ROWS[AXES.index(driving_axis(component))]


def felt_of(fit: GroundFit, pull: Array) -> Array:
    """What the sensors that read specific force lack of a pull of shape (n, 6), shape (n, m)."""
    reading = np.array([sensor.reads_gravity for sensor in fit.sensors], dtype=np.float64)
    return pull @ (fit.rows * IS_FORCE * reading[:, None]).T


@dataclass(frozen=True, slots=True, eq=False)
class MotionRecord:
    """A recording whose platform motion is wanted, with what was found of it so far.

    Attributes
    ----------
    recording
        The recording.
    first
        Fit of all motions that its sensors tell apart.
    pull
        Gravity at its angles.
    readings
        Readings of the sensors with gravity put back, shape (n, m).
    along
        The one component whose motion is wanted; None for all.
    delay
        Time by which all of it lags the clock [s]: that of the first sensor, or of the pitch where there is none.
    """

    recording: Recording
    first: GroundFit
    pull: Attitude
    readings: Array
    along: str | None
    delay: float

    @classmethod
    def of(cls, recording: Recording, *, along: str | None, gravity: float) -> MotionRecord:
        """Take the sensors and angles of a corrected recording; the arguments are those of `PlatformMotion.of`."""
        sensors = ground_sensors(recording) if along is None else driving_sensors(recording, along)
        clock = sensors[0].channel if sensors else recording.channels.get("pitch")
        delay = 0.0 if clock is None else clock.delay
        pull = Attitude.of(recording, gravity, delay=delay)
        if not any(sensor.reads_gravity for sensor in sensors):
            check_roll(recording, along=along, gravity=gravity)
        fit = GroundFit.of(sensors, rate=recording.rate)
        readings = fit.readings(recording.samples) + felt_of(fit, pull.acceleration)
        return cls(recording, fit, pull, readings, along, delay)

    def solved(self, gravity_uncertainty: float) -> PlatformMotion:
        """The motion; local gravity has this standard uncertainty [m/s^2]."""
        fit, known, variance, said = self.at_rest()
        found = Turning.of(fit, self.readings, known)
        effects = list(self._effects(found, gravity_uncertainty))
        if len(fit.sensors) > 1:
            readings = self.readings - known @ fit.rows.T - (found.felt if found.removed else 0.0)
            check_agreement(self.recording.name, fit, readings, found.motion, effects)
        covariance = self._covariance(fit, variance)
        return PlatformMotion(
            acceleration=found.motion,
            covariance=covariance,
            white_covariance=covariance + fit.white_covariance - fit.covariance,
            specific_force=found.motion - self.pull.acceleration if self.pull.angles else found.motion,
            turn_rate=found.rate,
            delay=self.delay,
            assumptions=(*said, *self._told(found, effects)),
            unknowns=tuple(self._unknowns(fit, effects, known)),
            gravity_on_zero=self.recording.gravity_on_zero.acceleration,
            delays=(*(sensor.channel.delay for sensor in fit.sensors), *self.pull.delays),
        )

    def at_rest(self) -> tuple[GroundFit, Array, Array, list[str]]:
        """Take motions that show nothing beyond their noise as their tones: the least sure first, then fit again.

        The fit of the others, what is taken as known, shape (n, 6), and the variance of its noise, shape (6,).
        """
        fit = self.first
        said: list[str] = []
        known, variance = np.broadcast_to(0.0, (self.readings.shape[0], 6)), np.zeros(6)
        if not fit.sensors:
            return fit, known, variance, said
        plain = np.array([s.kind == "turn" or s.channel.coupling == "kinematic" for s in fit.sensors], dtype=bool)
        plain &= np.array([s.kind != "rate" for s in fit.sensors], dtype=bool)
        while True:
            left = self.readings - known @ fit.rows.T if said else self.readings
            spread = np.diag(fit.covariance)
            motion, told = self._where_read(fit, fit.motion(left))
            ratios = {
                column: float(np.nanvar(motion[:, column]) / spread[column])
                for column in fit.columns
                if told[column]
                and spread[column] > 0
                and not any(band.gains[column, ~plain].any() for band in fit.bands)
            }
            least = min(ratios, key=ratios.__getitem__, default=-1)
            if least < 0 or ratios[least] >= AT_REST:
                return fit, known, variance, said
            known = known if said else np.zeros_like(known)
            # adding a sensor's noise to the force would only spoil it; tones that stand out of it are motion
            known[:, least], share = tones(motion[:, least])
            variance[least] = share**2 * spread[least]
            rest = "only its tones are taken" if share else "the ground end is taken to be at rest in it"
            said.append(
                f"the ground's {motion_name(least)} shows {'little' if share else 'nothing'} beyond its noise; {rest}"
            )
            fit = fit.only(set(fit.columns) - {least})

    def _where_read(self, fit: GroundFit, motion: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Motions of shape (n, 6), NaN where a sensor of one has no reading, and which of them are still told, (6,).

        A line across a gap is no motion, and a few samples beside one do not tell that there is none.
        """
        lost = np.column_stack([sensor.channel.missing for sensor in fit.sensors])
        if not lost.any():
            return motion, np.ones(6, dtype=bool)
        sizes = np.max([np.abs(band.gains) for band in fit.bands], axis=0)
        used = sizes > ROUNDING * sizes.max(axis=1, keepdims=True)
        bridged = lost.astype(np.float64) @ used.T > 0
        enough = min(FEWEST, len(motion) // 2)
        return np.where(bridged, np.nan, motion), np.count_nonzero(~bridged, axis=0) >= enough

    def _told(self, found: Turning, effects: Sequence[Effect]) -> Iterator[str]:
        """What is taken as zero or approximately because of what is not recorded."""
        reads_gravity = False
        if self.along is None:
            yield from taken_as_zero(self.first, found)
        elif not self.first.sensors:
            name = acceleration_name("ground", self.along)
            yield f"{name} is not recorded; the ground end is taken to be at rest along {self.along}"
        else:
            reads_gravity = self.first.sensors[0].reads_gravity
        if not reads_gravity:
            yield from self.pull.assumptions
        turns = [effect.source.removeprefix(TURNS) for effect in effects if effect.name.startswith(UNRECORDED)]
        if turns:
            along = " and ".join(turns)
            yield f"what {TURNS}{along} change of the weight is not taken off; it counts in the uncertainty"

    def _covariance(self, fit: GroundFit, variance: Array) -> Array:
        """Noise of one sample: of the sensors, of what is taken as known, and of the angles."""
        total = fit.covariance + fit.spread(
            [np.eye(6) - band.gains @ fit.rows for band in fit.bands], variance=variance
        )
        reading = np.array([sensor.reads_gravity for sensor in fit.sensors], dtype=np.float64)
        maps = [band.gains @ (fit.rows * IS_FORCE * reading[:, None]) - np.eye(6) for band in fit.bands]
        for name, slope in self.pull.slopes.items():
            size, shapes = np.linalg.eigh(slope.T @ slope / slope.shape[0])
            turned = [one @ shapes for one in maps]
            total = total + fit.spread(turned, variance=self.pull.noise[name] ** 2 * np.maximum(size, 0.0))
        return total

    def _effects(self, found: Turning, gravity_uncertainty: float) -> Iterator[Effect]:
        """What holds along the record and has an uncertainty, as changes of readings and of gravity."""
        fit, samples = self.first, self.readings.shape[0]
        for index, sensor in enumerate(fit.sensors):
            channel, straight = sensor.channel, sensor.kind == "acceleration"
            if channel.relative_uncertainty:
                raw = self.readings[:, index] - felt_of(fit, self.pull.acceleration)[:, index]
                yield Effect(GAINS[0 if straight else 1], channel.name, channel.relative_uncertainty, {index: raw})
            if sensor.kind != "rate" and channel.zero_uncertainty:  # a rate's zero has no derivative
                yield Effect(
                    "accelerometer zero" if straight else "turn sensor zero",
                    channel.name,
                    channel.zero_uncertainty,
                    {index: np.ones(samples)},
                )
            for column in sensor.gaps.T:
                yield Effect(f"{GAP}{channel.name}", channel.name, 1.0, {index: column})
            for axis, name in enumerate(AXES) if channel.place_uncertainty else ():
                by, turns = np.eye(3)[axis], DIRECTIONS[list(MOMENT_ROWS)]
                turn, w = found.motion[:, MOMENT_ROWS] @ turns, found.rate @ turns
                moved = (np.cross(turn, by) + np.cross(w, np.cross(w, by))) @ sensor.axis
                yield Effect(f"place {name}", channel.name, channel.place_uncertainty, {index: moved})
            for part in channel.cross_axis:
                across = -np.nan_to_num(self.recording.channel(part.channel).values)
                name = f"cross-axis sensitivity to {part.channel}"
                yield Effect(name, channel.name, part.uncertainty, {index: across})
        on_zero = self.recording.gravity_on_zero
        for name, slope in self.pull.slopes.items():
            channel = self.recording.channel(name)
            for word, u in (("zero", channel.zero_uncertainty), ("gain", channel.relative_uncertainty)):
                if u:
                    what, by = f"{name} {word}", slope if word == "zero" else slope * self.pull.angles[name][:, None]
                    yield Effect(what, name, u, self._felt_by(by), on_zero.slope(what) - by)
            for column in self.pull.gaps[name].T:
                by = slope * column[:, None]
                yield Effect(f"{GAP}{name}", name, 1.0, self._felt_by(by), -by)
        yield from self._unrecorded_attitude(found)
        if found.uncertainty:
            yield Effect(TURNING, "rate of turn", found.uncertainty, dict(enumerate(found.felt.T)))
        if gravity_uncertainty:
            by = self.pull.acceleration / self.pull.gravity
            on_zero_by = on_zero.acceleration / self.pull.gravity
            yield Effect("gravity", "gravity", gravity_uncertainty, self._felt_by(by), on_zero_by - by)

    def _unrecorded_attitude(self, found: Turning) -> Iterator[Effect]:
        """What turns that the sensors show change of the weight, where no angle tells the attitude.

        It is not taken off: from which attitude it turns is not known, and slow turns are lost with the lines that the
        sensors' zeros make. At level attitude it is what the forces have too much at most.
        """
        if self.pull.angles or self.along is not None or not found.rate.any():
            return
        angles, still = turned_by(self.first, found.rate), np.zeros(1)
        slopes = Gravity.of(still, still, gravity=self.pull.gravity).slopes
        for name, turn in (("pitch", "PM"), ("roll", "RM")):
            angle = angles[:, MOMENTS.index(turn)]
            if angle.any():
                by = angle[:, None] * slopes[name]
                yield Effect(f"{UNRECORDED}{name}", f"{TURNS}{turn}", 1.0, self._felt_by(by), -by)

    def _felt_by(self, pull: Array) -> dict[int, Array]:
        felt = felt_of(self.first, pull)
        return {index: felt[:, index] for index, sensor in enumerate(self.first.sensors) if sensor.reads_gravity}

    def _unknowns(self, fit: GroundFit, effects: list[Effect], known: Array) -> Iterator[SystematicParameter]:
        for effect in effects:
            slope = fit.motion(effect.readings(self.readings))
            if effect.pull is not None:
                slope = slope + effect.pull
            if effect.name in GAINS and known.any():
                slope = slope + self._share(effect.source) * known
            if slope.any():
                local = effect.name.startswith(GAP)
                yield SystematicParameter(effect.name, effect.source, slope, effect.uncertainty, local)

    def _share(self, name: str) -> Array:
        """Share of a sensor in every motion, shape (6,): by so much the gain of its tones is its own."""
        index = [sensor.channel.name for sensor in self.first.sensors].index(name)
        return np.asarray(self.first.bands[0].gains[:, index] * self.first.rows[index])
