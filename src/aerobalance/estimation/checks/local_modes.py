"""Resonances in the spectrum of a reading: the balance's own, as the record shows it, and one that the dynamics lack.

The spectrum that is learned for the force explains whatever the balance's model does not, so neither a missing mode
nor a changed spring shows in the innovations. What gives them away is their shape. Over a band that is wide for a
resonance but narrow for a load, the force's spectrum is taken for a power of frequency; then the averaged periodogram
of the reading is |G|^2 S_F + R, and frequency, damping ratio and share of a mode follow by maximum likelihood
[Whittle1953]_.

References
----------
.. [Whittle1953] P. Whittle, "Estimation and information in stationary time series", Ark. Mat. 2 (1953) 423.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from aerobalance.dynamics.modal import ModalModel, Mode
from aerobalance.estimation.checks.averaged_spectrum import BAND, INDEPENDENT, REACH, Averaged, smeared, unsmeared
from aerobalance.estimation.checks.spoken import OF_LOAD
from aerobalance.recording.channel import Array


@dataclass(frozen=True, slots=True)
class LocalModeSettings:
    """Thresholds of the search for resonances in a spectrum.

    Attributes
    ----------
    chance
        Standard deviations of an ordinate, in the logarithm, by which a peak that is looked at stands out.
    evidence
        Gain in twice the log-likelihood that a further mode must bring.
    likely, share
        Damping ratio and share from which the search for those of a further mode starts.
    drops
        Changes of the logarithm of the load's spectrum at an edge from which the search for one starts.
    heaviest
        Damping ratio above which a peak is the load's and no mode.
    most
        Share of a steady load, of either sign, from which on a peak is the load's and no mode: the mode that has more
        than half of it is the one that is known. A tone that wanders, alone, asks for 0.7 and more.
    excited
        Level of the balance's own resonance over the noise from which its frequency and damping are looked at.
    lack_of_fit
        Standard deviations by which the band may fit worse than by chance.
    nearby
        Part of a search step over which slopes of a response are taken.
    """

    chance: float = 4.5
    evidence: float = 60.0
    likely: float = 0.008
    share: float = 0.05
    drops: tuple[float, ...] = (-3.0, 3.0)
    heaviest: float = 0.1
    most: float = 0.5
    excited: float = 20.0
    lack_of_fit: float = 5.0
    nearby: float = 1e-6


SETTINGS: Final = LocalModeSettings()
"""Thresholds that are used."""

ALIKE: Final = 4.0
"""Difference in twice the log-likelihood up to which two fits are as likely: two standard deviations of one number."""


Power: TypeAlias = Callable[[Array], Callable[[Array], Array]]
"""Gives, at frequencies, the square of the response that parameters stand for."""


@dataclass(frozen=True, slots=True, eq=False)
class _LocalFit:
    """A fit over a band: parameters, their covariance, twice the log-likelihood, and how well the band is fitted."""

    point: Array
    covariance: Array
    twice_log_likelihood: float
    lack_of_fit: float


class MissingMode(NamedTuple):
    """A mode that the dynamics lack, and the standard uncertainties of its frequency [Hz] and its share [1]."""

    mode: Mode
    u_frequency: float
    u_share: float


def missing_mode(
    seen: Averaged, dynamics: ModalModel, *, largest_share: float = SETTINGS.most, load: float | None = None
) -> MissingMode | None:
    """The strongest peak that a further mode explains, and neither a smooth load nor the edge of its band does.

    A narrow band of the load itself looks the same. A mode has a share below `largest_share` of a steady load; in
    the reading of a decoupled component it may have any, as its row makes of the other components what it does of no
    force. A peak at the frequency `load` [Hz] is known to be the load's.
    """
    for centre in _peaks(seen, dynamics):
        band = seen.near(centre)
        if band.size < 16 or (load is not None and abs(centre / load - 1) < OF_LOAD):
            continue
        plain = _fit(seen, band, _fixed(dynamics), start=np.zeros(0), scale=np.zeros(0))
        most = _most_likely(seen, band) - SETTINGS.evidence
        if plain.twice_log_likelihood >= most:
            continue
        start = np.log([centre, SETTINGS.likely, SETTINGS.share])
        either = [_further_mode(seen, band, dynamics, start, sign=sign) for sign in (1, -1)]
        edge = _edge(seen, band, dynamics, max(either, key=_likelihood).mode)
        if edge.twice_log_likelihood >= most:
            continue
        price = 2 * np.log(band.size)  # Schwarz's, of the two numbers of an edge, which is no fault
        if edge.twice_log_likelihood - plain.twice_log_likelihood > price:
            # a mode alone would bend to an edge as well, and its share be another
            beside = _beside_an_edge(seen, band, dynamics, start, edge=edge.point)
            if max(map(_likelihood, beside)) - max(map(_likelihood, either)) > price:
                either = beside
        found = _with_share(either, below=largest_share)
        mode = found.mode
        width = 2 * mode.damping_ratio * mode.natural_frequency
        inside = abs(mode.natural_frequency / centre - 1) < BAND / 2
        if (
            _likelihood(found) - max(plain.twice_log_likelihood, edge.twice_log_likelihood) > SETTINGS.evidence
            and mode.damping_ratio < SETTINGS.heaviest
            and abs(mode.share) < largest_share
            and width > seen.resolution
            and inside
        ):
            others = [one for one in either if (one.mode.share > 0) != (mode.share > 0)]
            return _with_either_sign(found, max(others, key=_likelihood))
    return None


def _with_share(fits: list[_FurtherMode], *, below: float) -> _FurtherMode:
    """The likeliest fit; of those that are as likely the likeliest whose share is below a limit, where one is.

    With an edge of the load just above a mode its share and the load's level are hardly told apart.
    """
    best = max(fits, key=_likelihood)
    within = [one for one in fits if abs(one.mode.share) < below and _likelihood(best) - _likelihood(one) < ALIKE]
    return max(within, key=_likelihood, default=best)


def _most_likely(seen: Averaged, band: NDArray[np.intp]) -> float:
    """Twice the log-likelihood that no model exceeds: that of one which expects what is read, ordinate by ordinate."""
    return -2 * seen.averages * INDEPENDENT * float(np.sum(np.log(np.maximum(seen.power[band], 1e-300)) + 1))


class _FurtherMode(NamedTuple):
    """The likeliest fit with a further mode, whose parameters come first, and that mode."""

    fit: _LocalFit
    mode: Mode

    @property
    def variance(self) -> Array:
        """Variances of the natural frequency [Hz^2] and of the share [1], shape (2,)."""
        size = np.array([self.mode.natural_frequency, self.mode.share])
        return np.asarray(np.diag(self.fit.covariance)[[0, 2]] * size**2)  # the fit's are of the logarithms


def _likelihood(found: _FurtherMode) -> float:
    return found.fit.twice_log_likelihood


def _with_either_sign(found: _FurtherMode, other: _FurtherMode) -> MissingMode:
    """The likelier mode; the other sign of the share counts in the uncertainties by its probability."""
    probability = np.exp(-np.logaddexp(0, (_likelihood(found) - _likelihood(other)) / 2))
    apart = np.array(
        [other.mode.natural_frequency - found.mode.natural_frequency, other.mode.share - found.mode.share]
    )
    u = np.sqrt((1 - probability) * found.variance + probability * (other.variance + apart**2))
    return MissingMode(found.mode, float(u[0]), float(u[1]))


def _further_mode(
    seen: Averaged, band: NDArray[np.intp], dynamics: ModalModel, start: Array, *, sign: int, edge: Array | None = None
) -> _FurtherMode:
    """The likeliest fit with a further mode whose share has a sign, under a load with or without an edge.

    `start` has the logarithms of natural frequency [Hz], damping ratio and size of the share; `edge` the frequency of
    an edge of the load [Hz] and its change of the logarithm there.
    """
    scale = np.array([0.2 * SETTINGS.likely, 0.3, 0.5])

    def mode_at(point: Array) -> Mode:
        f, ratio, share = np.exp(point[:3])
        return Mode(float(f), float(ratio), float(sign * share))

    def bent(frequency: Array) -> Callable[[Array], Array]:
        beside = _beside_others(dynamics, frequency)

        def at(point: Array) -> Array:
            power = beside(mode_at(point))
            return power if edge is None else power * _edge_factor(seen, point[3:], frequency)

        return at

    if edge is not None:
        start, scale = np.concatenate([start, edge]), np.concatenate([scale, _edge_scale(seen)])
    fit = _fit(seen, band, bent, start=start, scale=scale)
    return _FurtherMode(fit, mode_at(fit.point))


def _beside_an_edge(
    seen: Averaged, band: NDArray[np.intp], dynamics: ModalModel, start: Array, *, edge: Array
) -> list[_FurtherMode]:
    """Fits with a further mode of either sign beside an edge, which is looked for also apart from the mode."""
    edges = [edge, *_steepest(seen, band, dynamics, beside=float(np.exp(start[0])))]
    return [_further_mode(seen, band, dynamics, start, sign=sign, edge=one) for sign in (1, -1) for one in edges]


def _edge(seen: Averaged, band: NDArray[np.intp], dynamics: ModalModel, mode: Mode) -> _LocalFit:
    """The likeliest fit with a load that ends or begins within the band: the edge's frequency [Hz] and its change."""

    def ending(frequency: Array) -> Callable[[Array], Array]:
        power = _power(dynamics, frequency)
        return lambda point: power * _edge_factor(seen, point, frequency)

    starts = [np.array([mode.natural_frequency, drop]) for drop in SETTINGS.drops]
    starts += _steepest(seen, band, dynamics)
    fits = [_fit(seen, band, ending, start=start, scale=_edge_scale(seen)) for start in starts]
    return max(fits, key=lambda fit: fit.twice_log_likelihood)


def _edge_factor(seen: Averaged, point: Array, frequency: Array) -> Array:
    """What an edge at a frequency [Hz] multiplies the load's spectrum by, at its change of the logarithm [1]."""
    away = np.minimum(np.maximum((frequency - point[0]) / (seen.resolution / 2), -30), 30)
    return np.asarray(np.exp(min(max(point[1], -30), 30) / (1 + np.exp(-away))))


def _edge_scale(seen: Averaged) -> Array:
    """Sizes of a step of the search for an edge: of its frequency [Hz] and of its change."""
    return np.array([2 * seen.resolution, 1.0])


def _steepest(seen: Averaged, band: NDArray[np.intp], dynamics: ModalModel, *, beside: float = -np.inf) -> list[Array]:
    """Frequencies [Hz] at which the load's spectrum falls and rises most, and the changes of its logarithm there.

    Those beside a frequency [Hz] are apart from what a resonance there makes of the load.
    """
    level = np.log(np.maximum(seen.power[band] / _power(dynamics, seen.frequency[band]), 1e-300))
    total = np.concatenate([[0.0], np.cumsum(level)])
    # between neighbours of so many ordinates, and near the ends of the band of what there is up to the end
    places = np.arange(REACH // 4, level.size - REACH // 4)
    if places.size < REACH:
        return []
    before, behind = np.minimum(places, REACH), np.minimum(level.size - places, REACH)
    change = (total[places + behind] - total[places]) / behind - (total[places] - total[places - before]) / before
    between = seen.frequency[band] - seen.resolution / 2
    change[np.abs(between[places] - beside) < 2 * REACH * seen.resolution] = 0.0
    return [np.array([between[places[one]], change[one]]) for one in (np.argmin(change), np.argmax(change))]


def _power(dynamics: ModalModel, frequency: Array) -> Array:
    return np.asarray(np.abs(dynamics.response(frequency)) ** 2)


def _fixed(dynamics: ModalModel) -> Power:
    """The square of the response of dynamics that nothing is looked for in."""

    def power(frequency: Array) -> Callable[[Array], Array]:
        found = _power(dynamics, frequency)
        return lambda _: found

    return power


def _beside_others(dynamics: ModalModel, frequency: Array) -> Callable[[Mode], Array]:
    """The square of the response at frequencies [Hz] with one more mode.

    It is what `_power` gives of `with_modes`; what does not hang on that mode is worked out once.
    """
    first, *others = dynamics.modes
    alone, rates = first.response(frequency), 2j * np.pi * frequency
    parts = [(mode.share + mode.rate_share * rates) * mode.response(frequency) for mode in others]
    shares = [mode.share for mode in others]

    def power(mode: Mode) -> Array:
        # a new mode shows none of its rate, so that of the first stays; the first has what others leave
        share = 1.0 - sum([*shares, mode.share])
        response = (share + first.rate_share * rates) * alone if first.rate_share else share * alone
        for part in parts:
            response = response + part
        return np.asarray(np.abs(response + mode.share * mode.response(frequency)) ** 2)

    return power


def own_resonance(seen: Averaged, dynamics: ModalModel) -> tuple[Array, Array, float] | None:
    """Relative change of natural frequency and damping ratio of the first mode, their covariance and the evidence.

    Returns
    -------
    change, covariance, evidence
        Shapes (2,) and (2, 2) [1], and the gain in twice the log-likelihood; None where the load does not excite the
        resonance, or is no power of frequency about it.
    """
    band = seen.near(dynamics.natural_frequency)
    place = int(np.argmin(np.abs(seen.frequency - dynamics.natural_frequency)))
    if (
        band.size < 16
        or dynamics.damping_ratio == 0
        or seen.power[place - 1 : place + 2].max() < SETTINGS.excited * seen.noise
    ):
        return None

    def changed(point: Array) -> ModalModel:
        w, ratio = np.exp(point)
        return dynamics.retuned(frequency=float(w), damping=float(ratio))

    plain = _fit(seen, band, _fixed(dynamics), start=np.zeros(0), scale=np.zeros(0))
    scale = np.array([0.3 * dynamics.damping_ratio, 0.2])
    found = _fit(seen, band, lambda f: lambda point: _power(changed(point), f), start=np.zeros(2), scale=scale)
    moved, ratio = np.exp(np.clip(found.point, -700, 700)) * (1.0, dynamics.damping_ratio)
    if (
        found.lack_of_fit > SETTINGS.lack_of_fit or abs(moved - 1) > BAND or ratio >= 1
    ):  # beyond the band, or no resonance: not told
        return None
    return found.point, found.covariance, found.twice_log_likelihood - plain.twice_log_likelihood


def _peaks(seen: Averaged, dynamics: ModalModel) -> list[float]:
    """Frequencies of the peaks that stand out of their surroundings, the strongest first [Hz]; not the modes known."""
    from scipy.ndimage import median_filter  # noqa: PLC0415 - takes 30 ms, and few records need it

    count = seen.power.size
    width = np.clip((BAND * np.arange(count)).astype(int), 12, None)
    level = np.log(np.maximum(seen.power, 1e-300))
    surroundings = np.empty(count)
    edge = 12
    while edge < count:  # the median's width grows with frequency, octave by octave
        part = slice(edge, min(2 * edge, count))
        half = int(width[part].mean())
        begin = max(edge - half, 0)
        medians = median_filter(level[begin : part.stop + half], 2 * half + 1, mode="nearest")
        surroundings[part] = medians[edge - begin : part.stop - begin]
        edge *= 2
    surroundings[:12] = level[:12]
    above = level - surroundings
    for mode in dynamics.modes:
        reach = 6 * mode.damping_ratio * mode.natural_frequency + 4 * seen.resolution
        above[np.abs(seen.frequency - mode.natural_frequency) < reach] = 0.0
    limit = SETTINGS.chance / np.sqrt(seen.averages)
    found: list[float] = []
    while len(found) < 3 and above.max() > limit:
        place = int(np.argmax(above))
        found.append(float(seen.frequency[place]))
        above[max(place - int(width[place]), 0) : place + int(width[place]) + 1] = 0.0
    return found


def _fit(seen: Averaged, band: NDArray[np.intp], power: Power, *, start: Array, scale: Array) -> _LocalFit:
    """Maximum likelihood over a band; level and slope of the force's spectrum come after the given parameters."""
    centre = float(seen.frequency[band].mean())
    frequency = seen.fine(band)
    log_ratio = np.clip(np.log(np.maximum(frequency, seen.resolution) / centre), -1, 1)
    transfer, ones = power(frequency), np.ones(frequency.size)
    weight = seen.averages * INDEPENDENT

    def load(point: Array) -> tuple[Array, Array]:
        """The square of the response, and the density of the force."""
        force = np.exp(np.minimum(np.maximum(point[start.size] + point[start.size + 1] * log_ratio, -690), 690))
        return transfer(point[: start.size]), force

    def expected(point: Array) -> Array:
        response, force = load(point)
        return smeared(response * force) + seen.noise

    level0 = float(np.median(seen.power[band] / power(seen.frequency[band])(start)))
    origin = np.concatenate([start, [np.log(max(level0, 1e-300)), 0.0]])
    size = np.concatenate([scale, [0.3, 1.0]])

    readings = seen.power[band]

    def loss(moved: Array) -> tuple[float, Array]:
        """Less the log-likelihood, and its slopes."""
        point = origin + size * moved
        impossible = 1e12, np.zeros(point.size)
        try:
            with np.errstate(all="ignore"):  # far from all that is likely, numbers may overflow
                response, force = load(point)
                level = smeared(response * force) + seen.noise
                if not (level > 0).all():
                    return impossible
                felt = unsmeared(weight * (1 - readings / level) / level) * force
                slopes = np.empty(point.size)
                for place in range(start.size):
                    beside = point[: start.size].copy()
                    beside[place] += SETTINGS.nearby * size[place]
                    slopes[place] = felt @ (transfer(beside) - response) / SETTINGS.nearby
                slopes[start.size :] = size[start.size :] * (felt * response @ np.column_stack([ones, log_ratio]))
                value = float(weight * np.sum(np.log(level) + readings / level))
        except ValueError:  # outside what dynamics can be
            return impossible
        return (value, slopes) if np.isfinite(slopes).all() else impossible

    found = minimize(loss, np.zeros(origin.size), jac=True, method="BFGS", options={"gtol": 1e-3, "maxiter": 60})
    point = origin + size * found.x
    shown = expected(point)
    slopes = np.column_stack(
        [(expected(point + 1e-4 * s * e) - expected(point - 1e-4 * s * e)) / (2e-4 * s * shown)
         for s, e in zip(size, np.eye(size.size), strict=True)]
    )  # fmt: skip
    covariance = np.linalg.pinv(weight * slopes.T @ slopes)
    ratio = seen.power[band] / shown
    lack_of_fit = float(np.mean((ratio - 1) ** 2) * seen.averages - 1) * np.sqrt(band.size * INDEPENDENT / 2)
    return _LocalFit(point[: start.size], covariance[: start.size, : start.size], -2 * float(found.fun), lack_of_fit)
