r"""The force along one component that has been made ready, Eq. (17) of [Gorbushin2020]_.

Three ways, one signature: the optimal estimator (the default), the paper's own derivatives, and the inverse limited to
a band. Each gives every sample a standard uncertainty.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, get_args

import numpy as np

from aerobalance.estimation.checks.assumptions import assumptions_of
from aerobalance.estimation.checks.colored_noise import slow_noise_doubts
from aerobalance.estimation.checks.faint_force import hidden_force
from aerobalance.estimation.checks.ground_alignment import ChannelAlignment, alone, with_channel_aligned
from aerobalance.estimation.checks.ground_channels import GroundFault
from aerobalance.estimation.checks.ground_doubts import ground_doubts
from aerobalance.estimation.checks.ground_witnesses import SETTINGS as GROUND_CHANNELS
from aerobalance.estimation.checks.mains_hum import hidden_doubts, hidden_harmonics, hum_doubts, lines_within_load
from aerobalance.estimation.checks.model_error import as_noise, error_behind
from aerobalance.estimation.checks.resolution import resolution_doubt, rounding_error
from aerobalance.estimation.checks.unexplained import excess_of, missed_force, sudden_excess
from aerobalance.estimation.direct import band_limited, central_differences, missed
from aerobalance.estimation.error_sources import Contribution, Noise
from aerobalance.estimation.force_smoother import (
    LARGEST_HUM,
    LinearSmoother,
    SignalModel,
    SmootherResult,
    fit_signal_model,
)
from aerobalance.estimation.ground_gaps import has_hidden_motion, with_hidden_motion
from aerobalance.estimation.independent_record import SingleRecord, moves_along_axis
from aerobalance.estimation.prior import Observation, SpectralPrior, fit_prior
from aerobalance.estimation.record import ComponentRecord
from aerobalance.estimation.result import ComponentForce, with_errors
from aerobalance.estimation.spectra.line_noise import Hum, Line
from aerobalance.estimation.spectra.noise_floor import departure_of
from aerobalance.estimation.spectra.noise_record import noise_spectrum_of
from aerobalance.estimation.spectra.noise_spectrum import NoiseSpectrum
from aerobalance.estimation.statespace.kalman import FORCE
from aerobalance.estimation.step_search import RINGS, StepSearch
from aerobalance.estimation.steps import columns_of
from aerobalance.motion.platform import SystematicParameter
from aerobalance.recording.channel import Array
from aerobalance.recording.components import si_unit
from aerobalance.recording.doubts import DOUBTED, SETTINGS, Doubt
from aerobalance.recording.errors import FitError, argument, warn_quality
from aerobalance.recording.noise import step_of
from aerobalance.recording.sensors import load_gain_left

Method = Literal["smoother", "paper"]

SAME_RATE: Final = 1e-3
"""Relative difference of two sampling rates that are the same."""

FREQUENCIES: Final = 4097
"""Frequencies from zero to half the sampling rate at which spectra are compared."""

NOT_EXPLAINED: Final = "force that the model does not explain"
"""Name of the error where readings show a force that the model of the load leaves out."""

HIDDEN_HARMONICS: Final = "harmonics of the load that noise hides"
"""Name of the error where a load that repeats may have more harmonics than are seen."""

NOISE_OR_FORCE: Final = "what may be force or noise"
"""Name of the error where a record does not tell far above the natural frequency which of them it shows."""

COUNTS: Final = 0.1
"""Rms of that over the rest of the uncertainty from which on it is counted."""

BEYOND_THE_BAND: Final = "force beyond the band, and at the ends"
"""Name of the error of a direct inverse where the force is too fast for it or its past or future is not recorded."""

TOLD: Final = 0.7
"""Logarithm of the ratio of powers from which on it is told that a channel states another noise than the run has: of
less a number rounded to one digit may be off."""

FILTER_MATTERS: Final = 0.5
"""What a filter takes off the force over its uncertainty, from which on it is worth a word."""

LONGEST_REACH: Final = 256
"""Samples beside something sudden, at most, in which the force goes wrong with it."""


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
        reading, doubts = _with_noise(record)
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
        reading, doubts = _with_noise(record)
        resolution = step_of(record.load) if moves_along_axis(record) else None
        signal = fit_signal_model(reading, hum=hum, resolution=resolution)
        smoothed = SmootherResult.of(signal.reading, learned=signal.learned, steps=signal.steps)
        return cls(record, hum, signal, smoothed, doubts)

    def estimate(self, *, few: bool = False, ground: Sequence[GroundFault] = ()) -> ComponentForce:
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
        white = fit.innovations
        if record.shared is None:
            level, strange, missed_there = _unexplained(record, fit, white, bends=signal.bends)
        else:  # what is noisier by what is not known there is no fault of the model
            calm = np.where(record.shared.level > 1, 0.0, white)
            level, strange, missed_there = _unexplained(record, fit, calm, bends=signal.bends)
            level = np.maximum(record.shared.level, level)
        doubts += strange
        lines = fit.sized(signal.hum)
        if self.hum == "mains":
            _tell_of_hum(record, lines, driven=self._driven)
        estimator, whole = fit.estimator, bool(reading.present.all())

        def through(series: Array) -> Array:
            return estimator.run(series if whole else np.where(reading.present[:, None], series, 0.0))

        def again(other: ComponentRecord) -> Array:
            changed = other.reading(hum=reading.hum, tones=reading.tones, drift=reading.drift)
            return LinearSmoother.of(changed, learned=learned, steps=steps).run(changed.filled[:, None])[:, 0]

        def moved(item: SystematicParameter) -> Array:
            return -through(record.felt_under(item)[:, None])[:, 0]

        noise = learned.noise if record.shared is None else record.shared.before
        errors: list[Contribution] = [
            *fit.noise_errors(level, sources=(record.dynamics.component, record.motion_source)),
            *fit.step_errors(estimator),
            record.parameter_errors(lambda: through(reading.filled[:, None])[:, 0], again, through, few=few),
            *record.motion_errors(moved),
            *record.reading_errors(fit.force, through),
        ]
        for doubt, error in ground_doubts(record.dynamics.component, ground, through, errors=tuple(errors)):
            doubts += [] if doubt is None else [doubt]
            errors.append(error)
        if missed_there.any():
            period = 1 / record.dynamics.natural_frequency
            errors.append(as_noise(missed_there, name=NOT_EXPLAINED, period=period, interval=record.interval))
        if signal.hidden:
            hidden = np.full(reading.values.size, signal.hidden)
            errors.append(Noise(HIDDEN_HARMONICS, record.dynamics.component, hidden, np.ones(1)))
        for told, unseen in (*self._behind_filter(errors), *self._unseen(errors)):
            errors += unseen
            doubts += told
        return record.finish(
            fit.force,
            errors,
            method=f"smoother, force's spectrum learned: {learned.spectrum}{_words_on_tones(reading.tones)}"
            f"{_words_on_noise(record, learned)}",
            noise=noise,
            bandwidth=_resolved_bandwidth(reading, learned),
            noise_gain=float(np.sqrt(np.mean(fit.variance))) / noise,
            steps=tuple(steps),
            bends=signal.bends,
            tones=fit.tones,
            hum=lines,
            learned=learned,
            shared=record.shared,
            doubts=tuple(doubts),
            assumed=tuple(assumptions_of(record, fit, through, hum=self.hum)),
            found_motion=self.found_motion,
        )

    @property
    def _driven(self) -> tuple[Line, ...]:
        """Lines at frequencies of the mains that are so large that nobody would record such hum."""
        largest = LARGEST_HUM * float(np.nanmax(np.abs(self.record.load)))
        return tuple(line for line in self._large if line.amplitude > largest)

    @property
    def _large(self) -> tuple[Line, ...]:
        """Lines at frequencies of the mains that are taken for force, unless the record of noise shows them too."""
        known = () if self.record.noise is None else self.record.noise.hum
        resolved = 1 / (self.signal.reading.values.size * self.record.interval)
        return tuple(
            line
            for line in self.signal.large
            if not any(abs(line.frequency - hum.frequency) < resolved + hum.width * hum.frequency for hum in known)
        )

    def _behind_filter(self, errors: Sequence[Contribution]) -> Iterator[tuple[list[Doubt], list[Contribution]]]:
        """What the filter of the load takes off the force that is not made up for."""
        record, fit = self.record, self.smoothed
        name, smooth = record.dynamics.component, fit.states[:, FORCE]
        low_pass = record.recording.low_passed.get(name)
        if low_pass is None:
            return
        error = error_behind(smooth, fit.force - smooth, low_pass, own=record.dynamics, interval=record.interval)
        effect, rest = (float(np.sqrt(np.mean(one**2))) for one in (error, _deviation(errors)))
        period = 1 / record.dynamics.natural_frequency
        noise = as_noise(error, name=f"{DOUBTED}filter gain", period=period, interval=record.interval)
        if effect < FILTER_MATTERS * rest:
            yield [], [noise]
            return
        frequency = np.linspace(0, 0.5 / record.interval, FREQUENCIES)
        whole = float(frequency[np.flatnonzero(load_gain_left(low_pass, frequency) > 1 - 1e-9)[-1]])
        unit = si_unit(name)
        text = (
            f"{name} was read behind a {low_pass}, which is undone in full up to {whole:.3g} Hz: beyond, its noise "
            "would be raised with it and pass for force. The force has power there, of which the filter takes off "
            f"{effect:.3g} {unit} rms; that is in the uncertainty"
        )
        advice = "record with a filter of a higher corner, above twice the highest frequency of the force"
        yield [Doubt("filter gain", name, text, advice, effect, unit)], [noise]

    def _unseen(self, errors: Sequence[Contribution]) -> Iterator[tuple[list[Doubt], list[Contribution]]]:
        """What the record leaves open of noise with a color, of a force that noise or a converter hide, and of hum."""
        record, reading, learned = self.record, self.signal.reading, self.signal.learned
        component, count = record.dynamics.component, reading.values.size
        unit = si_unit(component)
        for told, open_ in slow_noise_doubts(self.signal, component, unit=unit):
            yield [told] if told else [], [open_] if open_ else []
        floor = self.signal.floor
        if floor is not None:
            rest = float(np.sqrt(np.mean(_deviation(errors) ** 2)))
            told = floor.doubt(component, unit=unit) if floor.missing > SETTINGS.doubtful * rest else None
            if floor.missing > COUNTS * rest:
                missing = np.full(count, floor.missing)
                yield [told] if told else [], [Noise(NOISE_OR_FORCE, component, missing, floor.density)]
        hidden = hidden_force(reading, learned, left=self.smoothed.residuals)
        if hidden is not None:
            told = hidden.doubt(component, unit=unit)
            yield [told] if told else [], [hidden.error(component, count=count, interval=reading.interval)]
        if self.hum != "keep" and not self._driven:
            for doubt, noise in hum_doubts(
                record.dynamics,
                learned,
                named=() if isinstance(self.hum, str) else self.hum,
                large=self._large,
                of_load=self.signal.of_load,
                count=count,
                interval=reading.interval,
                unit=unit,
            ):
                yield [doubt], [noise]
        if self.hum == "mains" and record.noise is None:
            fit = self.smoothed
            left = np.where(reading.present, reading.filled - fit.columns @ fit.sizes, 0.0)
            lines = fit.sized(self.signal.hum)
            for doubt, noise in lines_within_load(reading, learned, lines=lines, unit=unit):
                yield [doubt], [noise]
            told, hidden_hum = hidden_doubts(
                component,
                hidden_harmonics(reading, learned, left, lines=lines, of_load=self.signal.of_load),
                rest=float(np.sqrt(np.mean(_deviation(errors) ** 2))),
                count=count,
                interval=reading.interval,
                unit=unit,
            )
            yield [told] if told else [], [*hidden_hum]
        step = step_of(record.load)
        error = rounding_error(reading, learned, step=step) if step else None
        if error is not None:
            rest = float(np.sqrt(sum(np.mean(one.deviation**2) for one in errors)))
            told = resolution_doubt(component, error, step=step, rest=rest, unit=unit)
            yield [told] if told else [], [error]


def _deviation(errors: Sequence[Contribution]) -> Array:
    """Standard uncertainty by some errors, shape (n,) [N]."""
    return np.asarray(np.sqrt(np.sum([one.deviation**2 for one in errors], axis=0)))


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


def _with_noise(record: ComponentRecord) -> tuple[Observation, tuple[Doubt, ...]]:
    """The reading with the noise that was given, unless its white part is not that of the run, and what that says."""
    reading, stated = record.reading(), record.noise is None
    if stated and record.recording.from_outputs:
        return reading, ()  # nobody has stated it: it is what calibration and zero leave of the gauge outputs
    ratio = departure_of(reading, stated=stated) if record.shared is None else None
    if ratio is None:
        return reading, ()
    judged = replace(reading, noise=None)
    if stated and abs(np.log(ratio)) < TOLD:
        return judged, ()
    name = record.dynamics.component
    unit, text = si_unit(name), f"the white noise of {name} has {ratio:.2g} times the power that "
    if stated:
        text += (
            f"its channel states ({reading.noise:.3g} {unit} a reading), as another gain or unit, or a force of a "
            "very wide band, would make it; it is judged from the run"
        )
    else:
        text += (
            "it has in the record of noise, as another gain, filter or cabling, or a force of a very wide band, would "
            "make it; it is judged from the run, and what the noise has beyond white is taken as recorded"
        )
    return judged, (Doubt("noise level", name, text, effect=0.0 if stated else None, unit=unit),)


def _search_ended(search: StepSearch) -> Doubt:
    """What it says that not all steps were found."""
    name = search.reading.dynamics.component
    kind = "unexplained" if search.end == RINGS else "too many steps"
    return Doubt(kind, name, search.said, unit=si_unit(name))


def _tell_of_hum(record: ComponentRecord, lines: tuple[Line, ...], *, driven: tuple[Line, ...]) -> None:
    """Say which lines at frequencies of the mains are not in the force, and which are, as they are a drive."""
    told = (
        (
            lines,
            (
                "are taken for mains hum and not for force; if a force was applied at such a frequency it is missing "
                f"from the result: keep it with {argument('hum', 'keep')}"
            ),
        ),
        (
            driven,
            (
                "lie where the mains do, but are so large a part of the record that they are taken for force; if they "
                f"are hum, the force is wrong by them: name their frequencies with {argument('hum')}"
            ),
        ),
    )
    unit = si_unit(record.dynamics.component)
    for some, what in told:
        named = [f"{line.frequency:.7g} Hz ({line.amplitude:.3g} {unit} in the reading)" for line in some]
        if named:
            warn_quality(
                f"{record.recording.name}: steady lines of {record.dynamics.component} at {', '.join(named)} {what}"
            )


def _unexplained(
    record: ComponentRecord, fit: SmootherResult, white: Array, *, bends: Sequence[float]
) -> tuple[Array, list[Doubt], Array]:
    """Variance of the innovations over what is expected, what it says, and the force that is missed, (n,) [N].

    At a sudden change of slope, of whose instants `bends` are [s], a stretch departs from any stationary force.
    """
    level, edges = excess_of(white)
    in_blocks = np.repeat(level, np.diff(edges))
    highest = _resolved_bandwidth(fit.reading, fit.learned)
    reach = min(int(np.ceil(0.5 / max(highest * record.interval, 1e-3))), LONGEST_REACH)
    raised = np.maximum(in_blocks, sudden_excess(white, reach=reach))
    strange = np.flatnonzero(level > 1)
    if not strange.size:
        return raised, [], np.zeros(white.size)
    missed = missed_force(fit.reading, fit.learned, residuals=fit.residuals, strange=in_blocks > 1)
    bent = [int(np.searchsorted(edges, at / record.interval, side="right")) - 1 for at in bends]
    strange = np.setdiff1d(strange, [one + beside for one in bent for beside in (-1, 0, 1)])
    if not strange.size:
        return raised, [], missed
    worst = int(strange[np.argmax(level[strange])])
    start, stop = (record.recording.start + float(edge) * record.interval for edge in edges[worst : worst + 2])
    name, unit = record.dynamics.component, si_unit(record.dynamics.component)
    there = missed[in_blocks > 1]
    size = float(np.sqrt(np.mean(there**2)))
    shown = f"the force that the readings show beyond it, {size:.3g} {unit} rms, is" if size else "that of noise is"
    text = (
        f"in {strange.size} of {level.size} stretches the readings of {name} "
        f"depart from what the model of balance and load expects, most between {start:.4g} and {stop:.4g} s "
        f"({np.sqrt(level[worst]):.2g} times the chance scatter); {shown} in the uncertainty there, but an error that "
        "the model makes everywhere is not"
    )
    return raised, [Doubt("unexplained", name, text, unit=unit)], missed


def _resolved_bandwidth(reading: Observation, learned: SpectralPrior) -> float:
    """Frequency up to which the force is stronger in the reading than the noise [Hz]; 0 if it is nowhere."""
    frequency = np.linspace(0, 0.5 / reading.interval, FREQUENCIES)[1:]
    transfer = np.abs(reading.dynamics.response(frequency)) ** 2
    force = transfer * learned.spectrum.density(frequency)
    noise = transfer * reading.input_density + learned.noise_density(frequency, interval=reading.interval)
    above = np.flatnonzero(force > noise)
    return float(frequency[above[-1]]) if above.size else 0.0
