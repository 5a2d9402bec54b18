r"""The force along one component that has been made ready, Eq. (17) of [Gorbushin2020]_.

Three ways, one signature: the optimal estimator (the default), the paper's own derivatives, and the inverse limited to
a band. Each gives every sample a standard uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, get_args

import numpy as np

from aerobalance.estimation.checks.assumptions import assumptions_of
from aerobalance.estimation.checks.ground_alignment import ChannelAlignment, alone, with_channel_aligned
from aerobalance.estimation.checks.ground_channels import NO_FINDINGS, GroundFindings
from aerobalance.estimation.checks.ground_doubts import ground_doubts
from aerobalance.estimation.checks.ground_witnesses import SETTINGS as GROUND_CHANNELS
from aerobalance.estimation.checks.left_open import left_open
from aerobalance.estimation.checks.mains_hum import driven_lines, tell_of_hum
from aerobalance.estimation.checks.model_error import as_noise
from aerobalance.estimation.checks.noise_level import with_noise_level
from aerobalance.estimation.checks.unexplained import unexplained_stretches
from aerobalance.estimation.direct import band_limited, central_differences, missed
from aerobalance.estimation.error_sources import Contribution, Noise
from aerobalance.estimation.force_smoother import LinearSmoother, SmootherResult
from aerobalance.estimation.ground_gaps import has_hidden_motion, with_hidden_motion
from aerobalance.estimation.independent_record import SingleRecord, moves_along_axis
from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.estimation.prior import fit_prior, resolved_bandwidth
from aerobalance.estimation.record import ComponentRecord
from aerobalance.estimation.result import ComponentForce, with_errors
from aerobalance.estimation.signal_model import SignalModel, fit_signal_model
from aerobalance.estimation.spectra.line_noise import Hum
from aerobalance.estimation.spectra.noise_record import noise_spectrum_of
from aerobalance.estimation.spectra.noise_spectrum import NoiseSpectrum
from aerobalance.estimation.step_search import RINGS, StepSearch
from aerobalance.estimation.steps import columns_of
from aerobalance.estimation.unread_ends import unread_ends
from aerobalance.motion.platform import SystematicParameter
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.errors import FitError
from aerobalance.recording.noise import step_of

Method = Literal["smoother", "paper"]

SAME_RATE: Final = 1e-3
"""Relative difference of two sampling rates that are the same."""

HIDDEN_HARMONICS: Final = "harmonics of the load that noise hides"
"""Name of the error where a load that repeats may have more harmonics than are seen."""

NOT_EXPLAINED: Final = "force that the model does not explain"
"""Name of the error where readings show a force that the model of the load leaves out."""

BEYOND_THE_BAND: Final = "force beyond the band, and at the ends"
"""Name of the error of a direct inverse where the force is too fast for it or its past or future is not recorded."""


def noise_of_component(record: ComponentRecord) -> NoiseSpectrum:
    """Spectrum of the noise of a component that has been made ready, its record being one of noise alone."""
    reading = record.reading()
    return noise_spectrum_of(
        reading.values,
        record.dynamics,
        interval=reading.interval,
        input_density=reading.input_density,
        name=record.recording.name,
    )


def estimated(record: ComponentRecord, *, method: Method, bandwidth: float | None, hum: Hum) -> ComponentForce:
    """Work out the force of one component that has been made ready."""
    if by_smoother(method=method, bandwidth=bandwidth):
        return Fitted.of(record, hum=hum).estimate()
    if record.noise is not None or hum not in ("mains", "keep"):
        what = "lines for hum" if record.noise is None else "a spectrum of noise"
        raise ValueError(f"only the smoother without a bandwidth can take {what}")
    _check(record)
    found = central_differences(record) if bandwidth is None else band_limited(record, bandwidth)
    # what lies beyond the band, as an optimal estimate shows it; without a search for steps, which takes longer
    smoothed = Fitted.without_steps(record).smoothed
    error, lasts = missed(record, found.values, smoothed.force, bandwidth)
    # a noise of some color and hum are taken for force by the smoother alone
    assumed = (
        one
        for one in assumptions_of(record, smoothed, smoothed.estimator.run, hum="keep")
        if one.kind != "colored noise"
    )
    found = replace(found, assumed=tuple(assumed))
    return with_errors(found, as_noise(error, name=BEYOND_THE_BAND, period=lasts, interval=record.interval))


def by_smoother(*, method: Method, bandwidth: float | None) -> bool:
    """Whether these settings ask for the optimal estimator.

    Raises
    ------
    ValueError
        There is no such method.
    """
    if method not in get_args(Method):
        raise ValueError(f"method must be smoother or paper, not {method!r}")
    return method == "smoother" and bandwidth is None


def _check(record: ComponentRecord) -> None:
    if not np.isfinite(record.dynamics.natural_frequency):
        raise FitError(
            f"mass and stiffness of {record.dynamics.component} leave the range that can be calculated with; check "
            "the units"
        )
    if record.noise is not None and abs(record.noise.interval / record.interval - 1) > SAME_RATE:
        raise FitError(
            f"{record.recording.name} has {1 / record.interval:g} samples a second and the record of noise "
            f"{1 / record.noise.interval:g}: record the noise with the rate, gains and filters of the run"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """One component by the smoother of `estimation.statespace.kalman`, its prior learned and its steps found.

    Attributes
    ----------
    record
        The component made ready.
    hum
        What was to be taken for hum.
    signal
        What the record is made of: hum, steps, and the spectral prior of the rest.
    smoothed
        The force.
    doubts
        What the record said against the noise that was given.
    found_motion
        What gaps hid of the ground's motion and its channels lack, as the load shows it, shape (n,) [m/s^2]; None
        where that was not looked for.
    """

    record: ComponentRecord
    hum: Hum
    signal: SignalModel
    smoothed: SmootherResult
    doubts: tuple[Doubt, ...] = ()
    found_motion: Array | None = None

    @classmethod
    def of(cls, record: ComponentRecord, *, hum: Hum, align: bool = False) -> Fitted:
        """Work out the force of a component that has been made ready.

        Parameters
        ----------
        record
            The component.
        hum
            What is to be taken for hum.
        align
            Whether the channels of the ground's motion are brought to what the load shows of it.

        Raises
        ------
        FitError
            The balance is not in the range that can be calculated with, or the noise has another sampling rate.
        """
        _check(record)
        if align and moves_along_axis(record):
            return cls._aligned(record, hum)
        found = cls._fitted(record, hum)
        if not has_hidden_motion(record):
            return found
        # at first what a gap hides is taken for force
        found = cls._fitted(with_hidden_motion(record, found.smoothed), hum)
        better = with_hidden_motion(record, found.smoothed)
        signal = replace(found.signal, reading=_with_values_of(better, found.signal.reading))
        smoothed = SmootherResult.of(signal.reading, learned=signal.learned, steps=signal.steps)
        change = better.motion.specific_force - record.motion.specific_force
        return cls(better, hum, signal, smoothed, found.doubts, change)

    @classmethod
    def without_steps(cls, record: ComponentRecord) -> Fitted:
        """Work out the force of a component whose steps, if any, are a part of the prior, which takes less time."""
        reading, doubts = with_noise_level(record)
        learned = fit_prior(reading, columns=columns_of([], reading))
        smoothed = SmootherResult.of(reading, learned=learned, steps=())
        return cls(record, "keep", SignalModel(reading, [], learned, (), ()), smoothed, doubts)

    @classmethod
    def _aligned(cls, record: SingleRecord, hum: Hum) -> Fitted:
        """The force with the channels of the ground's motion at the delays and of the gains that the load shows."""
        moved, found = record, cls.of(record, hum=hum)
        told: dict[str, ChannelAlignment] = {}
        for _ in range(GROUND_CHANNELS.rounds):
            settled = True
            for name in alone(record, found.smoothed).changes.channels:
                step = with_channel_aligned(moved, found.smoothed, name)
                if step is None:
                    continue
                moved, now = step
                told[name] = now.after(told[name]) if name in told else now
                settled &= now.settled
            found = cls.of(moved, hum=hum)
            if settled:
                break
        doubts = tuple(one.doubt(record.dynamics.component) for one in told.values() if one.clear)
        change = moved.motion.specific_force - record.motion.specific_force
        hidden = 0.0 if found.found_motion is None else found.found_motion
        return replace(found, doubts=(*found.doubts, *doubts), found_motion=change + hidden)

    @classmethod
    def _fitted(cls, record: ComponentRecord, hum: Hum) -> Fitted:
        reading, doubts = with_noise_level(record)
        resolution = step_of(record.load) if moves_along_axis(record) else None
        signal = fit_signal_model(reading, hum=hum, resolution=resolution)
        smoothed = SmootherResult.of(signal.reading, learned=signal.learned, steps=signal.steps)
        return cls(record, hum, signal, smoothed, doubts)

    def estimate(self, *, few: bool = False, ground: GroundFindings = NO_FINDINGS) -> ComponentForce:
        """The force with its uncertainty and what the record says against it.

        Parameters
        ----------
        few
            Whether it is enough to know what holds along the record by few numbers.
        ground
            What the loads say of the channels of the ground's motion.
        """
        record, signal, fit = self.record, self.signal, self.smoothed
        reading, steps, learned = signal.reading, signal.steps, signal.learned
        doubts = list(self.doubts)
        if signal.ended is not None:
            doubts.append(_search_ended(signal.ended))
        white, start = fit.innovations, record.recording.start
        if record.shared is None:
            level, strange, missed_there = unexplained_stretches(fit, white, start=start, bends=signal.bends)
        else:  # what is noisier by what is not known there is no fault of the model
            calm = np.where(record.shared.level > 1, 0.0, white)
            level, strange, missed_there = unexplained_stretches(fit, calm, start=start, bends=signal.bends)
            level = np.maximum(record.shared.level, level)
        doubts += strange
        lines = fit.sized(signal.hum)
        if self.hum == "mains":
            tell_of_hum(record, lines, driven=driven_lines(record, signal.large))
        estimator, whole = fit.estimator, bool(reading.present.all())

        def through(series: Array) -> Array:
            return estimator.run(series if whole else np.where(reading.present[:, None], series, 0.0))

        def again(other: ComponentRecord) -> Array:
            changed = other.reading(hum=reading.hum, tones=reading.tones, drift=reading.drift)
            return LinearSmoother.of(changed, learned=learned, steps=steps).run(changed.filled[:, None])[:, 0]

        def moved(items: Sequence[SystematicParameter]) -> Array:
            return -through(np.column_stack([record.felt_under(item) for item in items]))

        noise = learned.noise if record.shared is None else record.shared.before
        errors: list[Contribution] = [
            *fit.noise_errors(level, sources=(record.dynamics.component, record.motion_source)),
            *fit.step_errors(estimator),
            record.parameter_errors(lambda: through(reading.filled[:, None])[:, 0], again, through, few=few),
            *record.motion_errors(moved),
            *record.reading_errors(fit.force, through),
        ]
        for doubt, error in ground_doubts(record.dynamics.component, ground.faults, through, errors=tuple(errors)):
            doubts += [] if doubt is None else [doubt]
            errors.append(error)
        if missed_there.any():
            period = 1 / record.dynamics.natural_frequency
            errors.append(as_noise(missed_there, name=NOT_EXPLAINED, period=period, interval=record.interval))
        if signal.hidden:
            hidden = np.full(reading.values.size, signal.hidden)
            errors.append(Noise(HIDDEN_HARMONICS, record.dynamics.component, hidden, np.ones(1)))
        unread, told_of_them = unread_ends(record, fit)
        errors += unread
        doubts += told_of_them
        for told, unseen in list(left_open(record, signal, fit, hum=self.hum, errors=errors)):
            errors += unseen
            doubts += told
        return record.finish(
            fit.force,
            errors,
            method=f"smoother, force's spectrum learned: {learned.spectrum}{_words_on_tones(reading.tones)}"
            f"{_words_on_noise(record, learned)}",
            noise=noise,
            bandwidth=resolved_bandwidth(reading, learned),
            noise_gain=float(np.sqrt(np.mean(fit.variance))) / noise,
            steps=tuple(steps),
            bends=signal.bends,
            tones=fit.tones,
            hum=lines,
            learned=learned,
            shared=record.shared,
            doubts=tuple(doubts),
            assumed=(*assumptions_of(record, fit, through, hum=self.hum), *ground.assumed),
            found_motion=self.found_motion,
        )


def _with_values_of(record: ComponentRecord, reading: Observation) -> Observation:
    return replace(reading, values=record.reading().values)


def _words_on_tones(tones: Sequence[float]) -> str:
    """How many steady tones were found beside a spectrum, and from where to where."""
    if not tones:
        return ""
    if len(tones) == 1:
        return f"; a steady tone at {tones[0]:.4g} Hz"
    return f"; {len(tones)} steady tones from {tones[0]:.4g} to {tones[-1]:.4g} Hz"


def _words_on_noise(record: ComponentRecord, learned: SpectralPrior) -> str:
    """What the noise of the readings is taken for, where that is said or seen."""
    if record.noise is not None:
        return f"; noise of the record of noise: {record.noise}"
    if record.shared is not None:
        return "; noise that other components show is taken off"
    if learned.color is not None:
        return "; noise that is not white, as the run shows it"
    return ""


def _search_ended(search: StepSearch) -> Doubt:
    """What it says that not all steps were found."""
    name = search.reading.dynamics.component
    kind = "unexplained" if search.end == RINGS else "too many steps"
    return Doubt(kind, name, search.said, unit=si_unit(name))
