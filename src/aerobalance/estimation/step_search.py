"""The search for steps of the force, several at a time, each with the spectral prior of what else the force does.

Instants that promise most are proposed together where they cannot be taken for each other (`step_scan`), located
between samples, and the prior is learned again without them, because the first one was polluted by them. They are
taken up if the likelihood grows enough. So a record takes some turns of learning, not one for every step.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from aerobalance.estimation.least_squares import generalised_least_squares, log_likelihood
from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.estimation.prior import fit_prior, refine_edges
from aerobalance.estimation.spectra.periodogram import Spectrum
from aerobalance.estimation.statespace.kalman import KalmanFilter
from aerobalance.estimation.statespace.shaping_filter import ShapingFilter
from aerobalance.estimation.step_fit import as_one, fit_together, gain_of_another_model, gains_of_ramps, refine_step
from aerobalance.estimation.step_scan import Scan
from aerobalance.estimation.steps import SETTINGS, Step, columns_of, response_to, ringing_time, without_model_errors
from aerobalance.recording.progress import PROGRESS

TURNS: Final = 5
"""Times at most that new steps are located and the prior is learned without them."""

STILL: Final = 0.01
"""Change of an instant, in sampling intervals, at which that ends."""

SLIPS: Final = 2.5
"""Periods of the natural frequency by which a step may have been taken for one at another place."""

LINES: Final = 6
"""Segments of a spectrum above which it may be that of a force that returns."""

LESS: Final = 20.0
"""Gain that steps of such a force promise less than they bring at last: each hides in the spectrum of the others."""

SEVERAL: Final = 5
"""Steps of such a force that are taken up together at least."""

KEPT: Final = 4
"""Priors whose filters are kept."""

RINGS: Final = (
    "rings after a step as its dynamics do not: what they leave over is no steps and stays in the force, and smaller "
    "steps of the record are not looked for any more; identify the dynamics again"
)
"""What is told where steps would only correct a wrong model."""

MORE: Final = (
    "has more than {} steps: no more of them are looked for, and the others are taken for a force that fluctuates; "
    "divide the record"
)
"""What is told where further steps would be found."""

TOO_MANY: Final = (
    "has more than {} steps, too many for a record of this length: they are taken for a force that fluctuates; "
    "divide the record"
)
"""What is told where so many show from the beginning."""

Found = tuple[list[Step], SpectralPrior]
"""Steps, and the prior without them."""


def find_steps(reading: Observation) -> Found:
    """Return the steps of a record in the order of time, and the spectral prior of the force without them."""
    return StepSearch(reading).run()


@dataclass(slots=True, eq=False)
class StepSearch:
    """A search in one record.

    Attributes
    ----------
    reading
        The record.
    begin
        Its prior without any steps; None where that is to be learned.
    filters
        Priors that were asked for last, with their filters.
    end
        What to tell the user where the search has ended before all was found.
    bends
        Instants of sudden changes of the force's slope [s], which are no steps and a part of what the prior expects.
    """

    reading: Observation
    begin: SpectralPrior | None = None
    filters: list[tuple[SpectralPrior, KalmanFilter]] = field(default_factory=list)
    end: str = ""
    bends: list[float] = field(default_factory=list)

    def run(self) -> Found:
        """Return the steps in the order of their instants, and the prior of the force without them."""
        reading, steps, rounds = self.reading, list[Step](), 0
        columns = columns_of(steps, reading)
        learned = self.begin or refine_edges(reading, fit_prior(reading, columns=columns), columns=columns)
        faint, tested = 0, list[Step]()
        steps, learned = self._returning(learned, steps) or (steps, learned)
        returns = bool(steps)
        while max(len(steps), rounds) < self.most and not self.end:
            rounds += 1
            PROGRESS.note(f"{len(steps)} found so far" if steps else "")
            found = self._proposed(learned, steps, prior=learned)
            if self.end:
                break
            if found is None and returns:
                found = self._returning(learned, steps)
            if found is None and steps and tested != steps and learned.spectrum.levels.any():
                # what is taken for a fluctuating force may be what a ramp leaves that was fitted as a sudden step
                found = self._with_ramps(learned, steps)
                tested = found[0]
                found = None if tested == steps else found
            if (
                found is None
                and steps
                and faint < SETTINGS.faint_steps
                and self._is_faint(learned, beside=SETTINGS.faint * reading.swing)
            ):
                found = self._proposed(learned, steps, prior=_without_force(learned))
                faint += 1
            if found is None or self.end:
                break
            steps, learned = found
            sound = without_model_errors(steps, reach=self.reach)
            if len(sound) < len(steps):
                self.end, steps = RINGS, sound
                learned = fit_prior(reading, columns=columns_of(sound, reading))
        steps, learned = self._joined(sorted(steps, key=lambda step: step.instant), learned)
        if len(steps) >= self.most and self._scan(learned, steps).promise >= self.threshold:
            self.end = self.end or MORE
        if self.bends:  # those that show beside all steps
            scan = self._scan(learned, steps)
            scan.likeliest(threshold=self.threshold, most=self.most, known=steps)
            self.bends = sorted(scan.bends)
        return steps, learned

    @property
    def said(self) -> str:
        """What to tell the user where the search has ended before all was found; else empty."""
        return f"{self.reading.dynamics.component} {self.end.format(self.most)}" if self.end else ""

    @property
    def most(self) -> int:
        """Number of steps that are searched at most."""
        numbers = SETTINGS.most_numbers // self.reading.values.size
        return int(np.clip(numbers, SETTINGS.fewest_steps, SETTINGS.most_steps))

    @property
    def reach(self) -> float:
        """Time after a step in which what is left may be an error of the model [s]."""
        periods = SETTINGS.echo_periods / self.reading.dynamics.natural_frequency
        return max(ringing_time(self.reading), periods)

    @property
    def threshold(self) -> float:
        """Gain in twice the log-likelihood for which a step is accepted: the largest of n grows as 2 log n."""
        return SETTINGS.evidence + 2 * float(np.log(max(self.reading.values.size / SETTINGS.instants, 1.0)))

    def filter(self, learned: SpectralPrior) -> KalmanFilter:
        """Return the filter of a prior."""
        for prior, known in self.filters:
            if prior is learned:
                return known
        made = KalmanFilter.of(self.reading.system(learned), self.reading.present)
        self.filters = [*self.filters[1 - KEPT :], (learned, made)]
        return made

    def _scan(self, learned: SpectralPrior, steps: Sequence[Step]) -> Scan:
        return Scan.of(self.reading, self.filter(learned), columns_of(steps, self.reading))

    def _returning(self, learned: SpectralPrior, steps: list[Step]) -> Found | None:
        """Return the steps with further ones of a force that returns, and the new prior; None if there are none.

        What returns, such as a square wave, is expected by a prior of many narrow parts, and no change shows.
        """
        if np.count_nonzero(learned.spectrum.levels) <= LINES:
            return None
        columns = columns_of(steps, self.reading)
        smooth = fit_prior(self.reading, columns=columns, before=learned, smooth=True)
        return self._proposed(learned, steps, prior=smooth, less=0.0 if steps else LESS)

    def _proposed(
        self, learned: SpectralPrior, steps: list[Step], *, prior: SpectralPrior, less: float = 0.0
    ) -> Found | None:
        """Return the steps with the likeliest further ones under a prior, and the new prior; None if there are none.

        Where several are not taken up together, the likeliest is tried alone.

        Parameters
        ----------
        learned
            What was learned with the steps.
        steps
            Those that are known.
        prior
            The prior under which others are proposed.
        less
            How much less than the evidence, at which a step is taken up, it may promise where there are several.
        """
        room, scan = self.most - len(steps), self._scan(prior, steps)
        candidates = scan.likeliest(threshold=self.threshold - less, most=room + 1, known=steps)
        self.bends += scan.bends
        if candidates and self._is_the_models(prior, steps, candidates[0], promise=scan.promise):
            self.end = RINGS
            return None
        if len(candidates) > 1 and not steps:
            # many hide each other in what was learned with them
            showing = scan.likeliest(threshold=SETTINGS.evidence - LESS, most=room + 1, known=steps)
            if len(showing) > room:
                self.end = TOO_MANY
                return None
        if less and len(candidates) < SEVERAL:
            return None
        candidates = candidates[:room]
        if len(candidates) >= SEVERAL and not self._is_likely(learned, steps, candidates):
            candidates = candidates[: 0 if less else 1]
        for most in [room, 1][len(candidates) < 2 : 1 if less else 2] if candidates else []:
            found = self._accepted(learned, *self._settled(prior, steps, candidates[:most], most=most))
            if found is not None:
                return found
        return None

    def _is_likely(self, learned: SpectralPrior, steps: list[Step], candidates: list[Step]) -> bool:
        """Whether many candidates may bring the evidence together, before they are located one by one.

        A load that returns without any step, such as a triangular wave, shows many as well. Steps at a sample and on
        either side of it stand for one between them.
        """
        reading, interval = self.reading, self.reading.interval
        known = columns_of(steps, reading)
        beside = [replace(step, instant=step.instant + k * interval) for step in candidates for k in (-1, 0, 1)]
        columns = np.column_stack([known, *(response_to(step, reading) for step in beside)])
        priors = (learned, fit_prior(reading, columns=columns))
        with_them, without = (
            max(log_likelihood(reading, self.filter(prior), columns=shapes) for prior in priors)
            for shapes in (columns, known)
        )
        return 2 * (with_them - without) >= len(candidates) * self.threshold / 2

    def _is_the_models(self, prior: SpectralPrior, steps: list[Step], candidate: Step, *, promise: float) -> bool:
        """Whether a candidate explains less than another frequency and damping after a larger step before it would."""
        before = [place for place, step in enumerate(steps) if 0 < candidate.instant - step.instant < self.reach]
        if not before:
            return False
        largest = max(before, key=lambda place: abs(steps[place].height))
        gain = gain_of_another_model(self.reading, self.filter(prior), steps, largest)
        return gain > max(promise, self.threshold)

    def _settled(
        self, learned: SpectralPrior, older: list[Step], fresh: list[Step], *, most: int
    ) -> tuple[int, Found]:
        """Locate new steps with the prior, learn the prior without them, and so on until neither changes.

        Returns
        -------
        number
            Number of older steps, which come first.
        found
            Steps and prior.
        """
        reading, number = self.reading, len(older)
        steps = [*older, *fresh]
        for turn in range(TURNS):
            placed = [step.instant for step in steps]
            if turn:
                steps = [*steps[:number], *self._located_again(learned, steps, number, most=most)]
            whitening = self.filter(learned)
            new = range(number, len(steps))
            slow = [*_neighbours(steps, number), *new] if turn == 1 else new
            for place in self._to_be_refined(learned, steps, slow) if turn else new:
                # the first prior was learned with these steps in the record, and would show ramps where there are none
                steps[place] = refine_step(reading, whitening, steps, place, ramps=turn > 0)
            if turn > 0:
                steps = fit_together(reading, whitening, steps)
            # the same prior would leave a part of the steps in the next one
            before = learned if turn > 0 else None
            learned = fit_prior(reading, columns=columns_of(steps, reading), before=before)
            if turn > 0 and len(placed) == len(steps):
                moved = max(abs(step.instant - instant) for step, instant in zip(steps, placed, strict=True))
                if moved < STILL * reading.interval:  # an earlier one may still be displaced by these
                    break
        # what is left of other steps would be taken for that of a ramp
        known = most == 1 or self._is_faint(learned, beside=SETTINGS.faint * reading.swing)
        return number, self._with_ramps(learned, steps) if known else (steps, learned)

    def _located_again(self, learned: SpectralPrior, steps: list[Step], number: int, *, most: int) -> list[Step]:
        """Return the new steps, to a sample where another place is likelier, and those that show beside them now."""
        scan, found = self._scan(learned, steps), []
        periods = np.inf if most == 1 else SLIPS
        for place in range(number, len(steps)):
            step = steps[place]
            near = scan.without(1 + place).likeliest_near(step, periods=periods)
            found.append(step if abs(near.instant - step.instant) < 2 * self.reading.interval else near)
        room = min(most, self.most - number) - len(found)
        return [*found, *scan.likeliest(threshold=self.threshold, most=room, known=steps, fresh=number)]

    def _to_be_refined(self, learned: SpectralPrior, steps: list[Step], slow: Iterable[int]) -> list[int]:
        """Return the places of steps that are known to a sample only or may have a duration, and of some that have.

        The others are fitted all together.
        """
        gains = gains_of_ramps(self.reading, self.filter(learned), steps)
        rough = {place for place, step in enumerate(steps) if step.height == 0}
        ramps = set(np.flatnonzero(gains > SETTINGS.ramp_evidence / 2).tolist())
        return sorted(rough | ramps | {place for place in slow if steps[place].duration > 0})

    def _with_ramps(self, learned: SpectralPrior, steps: list[Step]) -> Found:
        """Return the same or, if that is more likely, steps and prior with durations for sudden steps.

        If a ramp was fitted as a sudden step, the prior explains the remainder as a fluctuating force, and nothing is
        left that shows a ramp. So ramps are tested with a prior without such a force.
        """
        strict, ramps = self.filter(_without_force(learned)), {}
        gains = gains_of_ramps(self.reading, strict, steps)
        for place in range(len(steps)):
            if gains[place] > SETTINGS.ramp_evidence / 2:
                ramp = refine_step(self.reading, strict, steps, place, ramps=True)
                if ramp.duration > 0:
                    ramps[place] = ramp
        tried = len(ramps)
        while ramps:
            found, ramps = self._ramps_tested(steps, learned, ramps)
            if found is not None:
                return found
            if len(ramps) == tried:
                break
            tried = len(ramps)
        for place in ramps if len(ramps) > 1 else ():
            steps, learned = self._ramps_tested(steps, learned, {place: ramps[place]})[0] or (steps, learned)
        return steps, learned

    def _ramps_tested(
        self, steps: list[Step], learned: SpectralPrior, ramps: dict[int, Step]
    ) -> tuple[Found | None, dict[int, Step]]:
        """Return steps and prior with some steps replaced by ramps, None if that is not more likely.

        The second answer are the ramps that leave no more steps beside them.
        """
        reading = self.reading
        trial = [ramps.get(place, step) for place, step in enumerate(steps)]
        relearned = fit_prior(reading, columns=columns_of(trial, reading))
        trial = fit_together(reading, self.filter(relearned), trial)
        relearned = fit_prior(reading, columns=columns_of(trial, reading), before=relearned)
        (sudden, _), (slow, better) = self._most_likely_priors((learned, relearned), steps, trial)
        if 2 * (slow - sudden) < SETTINGS.ramp_evidence * len(ramps):
            return None, ramps
        # of two steps close to each other a ramp explains much, but not all
        scan = self._scan(_without_force(better) if self._is_faint(better) else better, trial)
        good = {
            place: ramp
            for place, ramp in ramps.items()
            if scan.promise_near(trial[place], periods=SLIPS) < self.threshold
        }
        return (trial, better) if len(good) == len(ramps) else None, good

    def _accepted(self, learned: SpectralPrior, number: int, settled: Found) -> Found | None:
        """Return the older steps with those located last that bring the evidence, and the prior; None if none does."""
        reading, (trial, relearned) = self.reading, settled
        while True:
            if max(abs(step.height) for step in trial) > SETTINGS.highest * reading.swing:
                return None
            columns = columns_of(trial, reading)
            relearned = refine_edges(reading, relearned, columns=columns)
            # each prior was learned from a periodogram, which hardly sees what happens near the ends of the record
            (without, _), (with_it, better) = self._most_likely_priors((learned, relearned), trial[:number], trial)
            sizes, covariance, _ = generalised_least_squares(self.filter(better), reading.filled, columns)
            places = np.arange(1 + number, 1 + len(trial))
            alone = sizes[places] ** 2 / np.maximum(np.diag(covariance)[places], 1e-300)
            # each in proportion to what it brings while the prior stays
            evidence = 2 * (with_it - without) * alone / max(float(np.sum(alone)), 1e-300)
            fresh = [replace(step, evidence=float(gain)) for step, gain in zip(trial[number:], evidence, strict=True)]
            clear = [step for step in fresh if step.evidence >= self.threshold]
            if len(clear) == len(fresh):
                found = self._still_clear([*trial[:number], *fresh], better)
                # of several the first were located with a prior that knew little of the last
                return (fit_together(reading, self.filter(found[1]), found[0]), found[1]) if len(fresh) > 1 else found
            if 2 * len(clear) < len(fresh):
                return None
            trial = [*trial[:number], *clear]
            relearned = fit_prior(reading, columns=columns_of(trial, reading), before=relearned)
            trial = fit_together(reading, self.filter(relearned), trial)

    def _still_clear(self, steps: list[Step], learned: SpectralPrior) -> Found:
        """Return steps and prior, without steps that only another prior showed."""
        sizes, covariance, _ = generalised_least_squares(
            self.filter(learned), self.reading.filled, columns_of(steps, self.reading)
        )
        gains = (sizes**2 / np.maximum(np.diag(covariance), 1e-300))[1 : 1 + len(steps)]
        clear = [step for step, gain in zip(steps, gains, strict=True) if gain >= self.threshold]
        if len(clear) == len(steps):
            return steps, learned
        learned = fit_prior(self.reading, columns=columns_of(clear, self.reading), before=learned)
        return fit_together(self.reading, self.filter(learned), clear), learned

    def _most_likely_priors(
        self, priors: tuple[SpectralPrior, ...], *readings: list[Step]
    ) -> list[tuple[float, SpectralPrior]]:
        """Return the largest log-likelihood of each set of steps, and the prior under which it is reached."""
        found = []
        for steps in readings:
            columns = columns_of(steps, self.reading)
            likelihoods = [log_likelihood(self.reading, self.filter(prior), columns=columns) for prior in priors]
            best = int(np.argmax(likelihoods))
            found.append((likelihoods[best], priors[best]))
        return found

    def _joined(self, steps: list[Step], learned: SpectralPrior) -> Found:
        """Return steps and prior with one step for two close to each other, where both bring no more than that."""
        reading, place = self.reading, 1
        while place < len(steps):
            trial = as_one(reading, self.filter(learned), steps, place)
            place += 1
            if trial is None:
                continue
            relearned = fit_prior(reading, columns=columns_of(trial, reading), before=learned)
            trial = fit_together(reading, self.filter(relearned), trial)
            (both, _), (alone, better) = self._most_likely_priors((learned, relearned), steps, trial)
            if 2 * (both - alone) < self.threshold:
                steps, learned = self._with_ramps(better, trial)
                place -= 1
        return steps, learned

    def _is_faint(self, learned: SpectralPrior, *, beside: float = 0.0) -> bool:
        """Return whether the force of a prior has a smaller rms in the observations than noise, or than a size [N].

        It may be the remainder of a step that was fitted wrongly: a ramp for two steps, or a step for a ramp.
        """
        interval = self.reading.interval
        frequency = np.linspace(0, 0.5 / interval, 4097)[1:]
        load = np.abs(self.reading.dynamics.response(frequency)) ** 2 * learned.spectrum.density(frequency)
        return bool(0 < float(np.mean(load)) < max(learned.noise, beside) ** 2 * interval)


def _neighbours(steps: Sequence[Step], number: int) -> list[int]:
    """Places of the older steps that are nearest to new ones: they were located while these were not yet known."""
    fresh = np.array([step.instant for step in steps[number:]])
    away = [float(np.min(np.abs(fresh - step.instant))) for step in steps[:number]]
    return [int(place) for place in np.argsort(away)[: SETTINGS.neighbours]]


def _without_force(learned: SpectralPrior) -> SpectralPrior:
    """Return a prior with the same noise and a force that does not fluctuate."""
    return replace(learned, spectrum=Spectrum(np.zeros(0), np.zeros(0)), shaping=ShapingFilter.silent())
