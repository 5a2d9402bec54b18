"""What recordings of taps say against the force, the points and the linearity that their fit takes for granted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.special import chdtrc

from aerobalance.dynamics.single import Dynamics
from aerobalance.identification.coupled.combinations import pairs
from aerobalance.identification.coupled.least_squares import whitener_of
from aerobalance.identification.impact.tap_fit import TapFit
from aerobalance.identification.impact.tap_model import Point, after_contact
from aerobalance.identification.impact.tap_record import TapRecord
from aerobalance.identification.impact.tap_stages import BY_CHANCE, LoadsFound, PlacedTap, departure
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS, FROM_VECTORS
from aerobalance.recording.doubts import Doubt
from aerobalance.recording.wording import percent_text

SEEN: Final = 100.0
"""Energy of a mode over the noise of one reading from which a tap tells its frequency and damping by itself."""

LATE: Final = 0.02
"""Delay of the force, in sampling intervals, from which it is told."""

FROM_DAMPING: Final = 1.0
"""Effect from which it is not told as a figure."""


DOUBTFUL: Final = 0.1
"""Relative standard uncertainty of the damping above which it is called hardly told."""


@dataclass(frozen=True, slots=True, eq=False)
class PointsJudged:
    """What the taps say of the points and directions as stated.

    Attributes
    ----------
    points
        The points to go on with: as stated, or with loads that are not known where the taps say otherwise.
    u_gain
        Standard uncertainty of the gain of the force to go on with.
    doubts
        What was found.
    scale
        Loads of these points over those stated, where the force has another gain or sign [1].
    """

    points: list[Point]
    u_gain: float
    doubts: list[Doubt]
    scale: float = 1.0


def left_out(records: Sequence[TapRecord], component: str) -> list[Doubt]:
    """Return doubts about taps that are left out, or of which the ringing alone is used."""
    doubts = []
    texts = {
        "double hit": (
            "the hammer touched twice; the tap is left out",
            "let the hammer hang loosely and pull it back at once, or take a lighter one",
            "double hit",
        ),
        "clipped": (
            "the force rests on a limit; its ringing alone is used",
            "choose a larger range of the hammer's channel, or tap more softly",
            "clipped force",
        ),
        "gap": ("readings of the force are missing; its ringing alone is used", "", "clipped force"),
        "no pretrigger": (
            "no readings before it tell how the balance still moved; its ringing alone is used",
            "begin to record 0.25 s before the tap",
            "no pretrigger",
        ),
    }
    for fault, (text, advice, kind) in texts.items():
        names = [
            f"{record.name} at {record.instant(tap):.4g} s"
            for record in records
            for tap in record.taps
            if tap.fault == fault
        ]
        if names:
            doubts.append(Doubt(kind, component, f"{_listed(names)}: {text}", advice, 0.0, "1"))
    for record in records:
        if record.corner:
            text = (
                f"{record.name}: the force's channel passes no slow changes (a high-pass of {record.corner:.3g} Hz, "
                f"u = {record.u_corner:.1g}), as piezoelectric hammers do; it is undone"
            )
            advice = "nothing is needed; a charge amplifier set to a long time constant avoids it"
            doubts.append(Doubt("force droop", component, text, advice, 0.0, "1"))
    return doubts


def missing_mode(peak: float | None, component: str) -> list[Doubt]:
    """Return the doubt that the balance rings near a frequency [Hz] as the modes fitted do not."""
    if peak is None:
        return []
    text = f"the balance rings near {peak:.4g} Hz as the modes that were fitted do not, and the dynamics lack that"
    return [Doubt("missing mode", component, text, "ask for more modes (modes='auto')", None, "1")]


def _listed(names: Sequence[str], most: int = 4) -> str:
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


def judged_points(
    points: Sequence[Point],
    found: Sequence[LoadsFound | None],
    *,
    u_gain: float,
    component: str,
    sizes: Array,
    names: tuple[str, ...],
) -> PointsJudged:
    """Compare the loads of 1 N as stated with those that the taps show.

    A channel of the force with another gain or sign is wrong at all points in one proportion; a point or a direction
    that is wrong is so for itself.
    """
    told = [
        (place, point, one) for place, (point, one) in enumerate(zip(points, found, strict=True)) if one is not None
    ]
    chances = [
        departure(one.loads - point.loads, _spread(point, one) + u_gain**2 * np.outer(point.loads, point.loads))
        for _, point, one in told
    ]
    if min(chances) > BY_CHANCE / len(told):
        return PointsJudged(list(points), u_gain, [])
    scale, u_scale = _scale(told)
    scaled = [
        departure(
            one.loads - scale * point.loads,
            _spread(point, one, scale) + u_gain**2 * scale**2 * np.outer(point.loads, point.loads),
        )
        for _, point, one in told
    ]
    if min(scaled) > BY_CHANCE / len(told) and scale != 0:
        kind, text = _scale_text(scale, u_scale, u_gain, one=len(told) == 1)
        advice = (
            "look up the sensitivity of the hammer with the tip and the extender that are on it"
            if scale > 0
            else "turn the sign of the force in the channel map, or the direction"
        )
        made = [replace(point, loads=scale * point.loads, root=scale * point.root) for point in points]
        return PointsJudged(made, max(u_gain, u_scale), [Doubt(kind, component, text, advice, 0.0, "1")], scale)
    kept, doubts = list(points), []
    for (place, point, one), chance in zip(told, chances, strict=True):
        if chance > BY_CHANCE / len(told):
            continue
        turned = departure(
            one.loads + point.loads, _spread(point, one) + u_gain**2 * np.outer(point.loads, point.loads)
        )
        kind, what = ("force sign", "the force has the other sign") if turned > BY_CHANCE else ("tap point", "")
        what = what or f"the balance was not tapped there or that way ({_shown(one.loads * sizes, names)})"
        text = f"taps at {point.name}: {what}; the loads that the taps show are taken"
        advice = "check the point and the direction, aft, right and up from the balance's centre"
        doubts.append(Doubt(kind, component, text, advice, 0.0, "1"))
        size = 30 * max(float(np.abs(point.loads).max()), float(np.abs(one.loads).max()))
        kept[place] = Point(point.name, one.loads, size * np.eye(one.loads.size))
    return PointsJudged(kept, u_gain, doubts)


def _spread(point: Point, one: LoadsFound, scale: float = 1.0) -> Array:
    return np.asarray(one.covariance + scale**2 * point.root @ point.root.T)


def _scale(told: Sequence[tuple[int, Point, LoadsFound]]) -> tuple[float, float]:
    """Loads found over those stated, by all points together, and its standard uncertainty."""
    along, square = 0.0, 0.0
    for _, point, one in told:
        spread = _spread(point, one)
        floor = 1e-12 * float(np.trace(spread)) * np.eye(len(spread))
        weighed = np.linalg.solve(spread + floor, point.loads)
        along += float(weighed @ one.loads)
        square += float(weighed @ point.loads)
    return along / square, float(square**-0.5)


def _scale_text(scale: float, u_scale: float, u_gain: float, *, one: bool) -> tuple[str, str]:
    """Kind and text of a force whose channel has another gain or sign."""
    where = ", or the point is another" if one else ""
    size = f"{abs(scale):.4g} (u = {u_scale:.1g}) times its reading as the balance shows it"
    if scale < 0:
        return "force sign", f"the force has the other sign, and is {size}{where}"
    text = (
        f"the force is {size}; its gain was taken to be known to {percent_text(u_gain, most=1.0)}{where}; the "
        "balance's own calibration is taken"
    )
    return "force gain", text


def _shown(loads: Array, names: tuple[str, ...]) -> str:
    """Direction and point of a force of these loads in words, or the loads where not all are known."""
    if names != COMPONENTS:
        return "1 N of it loads " + ", ".join(
            f"{name} by {value:.3g}" for name, value in zip(names, loads, strict=True)
        )
    whole = FROM_VECTORS.T @ loads
    force, moment = whole[:3], whole[3:]
    size = float(np.linalg.norm(force))
    near = np.cross(force, moment) / size**2
    direction = ", ".join(f"{value:.3f}" for value in force / size)
    place = ", ".join(f"{1000 * value:.1f}" for value in near)
    return f"they push along ({direction}) with {size:.3g} N per N, on a line through ({place}) mm"


def taps_that_differ(taps: Sequence[PlacedTap], flags: Sequence[bool], component: str) -> list[Doubt]:
    """Return the doubt about taps whose force does not go with the ringing that they left."""
    names = [tap.name for tap, flag in zip(taps, flags, strict=True) if flag]
    if not names:
        return []
    text = (
        f"{_listed(names)}: the force does not go with the ringing after it as at the other taps; its ringing alone "
        "is used"
    )
    return [Doubt("tap apart", component, text, "tap at the marked point, and pull the hammer back at once", 0.0, "1")]


def late_force(fit: TapFit, *, rate: float, u_delay: float, delay: float, component: str) -> list[Doubt]:
    """Return the doubt that the force is late or early against the loads; it is taken into account."""
    if abs(delay) < 5 * u_delay or abs(delay) * rate < LATE:
        return []
    text = (
        f"the force is {1e6 * abs(delay):.3g} us (u = {1e6 * u_delay:.1g}) {'late' if delay > 0 else 'early'} against "
        f"the loads, {abs(delay) * rate:.2g} sampling intervals; that is taken into account"
    )
    advice = "measure both through filters of one kind, or state the delay in the channel map"
    return [Doubt("force delay", component, text, advice, 0.0, "1")]


def damping_hardly_told(dynamics: Dynamics, teller: str, advice: str) -> list[Doubt]:
    """Return the doubt that what tells the damping, in words, hardly does so."""
    u, damping = dynamics.uncertainty("damping"), dynamics.damping
    if u <= DOUBTFUL * damping:
        return []
    relative = u / damping if damping else None
    text = f"{teller} tells the damping to {100 * relative:.2g} % only" if relative else f"{teller} shows no damping"
    return [Doubt("damping hardly told", dynamics.component, text, advice, relative, "1")]


@dataclass(frozen=True, slots=True, eq=False)
class TapScatter:
    """How the taps differ in the frequency and damping that each shows by itself.

    Attributes
    ----------
    mode
        Number of the mode that differs most.
    chi2, degrees_of_freedom
        Squares of the departures from their mean over their variances.
    frequency, damping
        Largest less smallest, of the frequency and of the damping, over their mean [1].
    stronger
        Whether damping is larger after stronger taps.
    """

    mode: int
    chi2: float
    degrees_of_freedom: int
    frequency: float
    damping: float
    stronger: bool


def scatter_of(fit: TapFit) -> TapScatter | None:
    """Test whether taps of different strength show the same frequencies and damping; None where they do."""
    motion, whitener = fit.motion, whitener_of(fit.noise)
    up, _ = pairs(motion)
    worst: TapScatter | None = None
    least = BY_CHANCE / max(up.size, 1)
    for number, pole in enumerate(up):
        shifts, variances, sizes = [], [], []
        for tap, own, linear in zip(fit.taps, fit.own, fit.linears, strict=True):
            amplitude = after_contact(
                tap, motion, fit.common, own=own, point=fit.points[tap.point], off=fit.off[tap.point]
            )[pole]
            wave = np.exp(tap.time[tap.before :] * motion.poles[pole])
            shape = whitener @ (motion.felt[:, pole] * amplitude)
            felt = wave[:, None] * shape
            if np.sum(np.abs(felt) ** 2) < SEEN:
                continue
            steep = tap.time[tap.before :, None] * felt
            table = np.column_stack([2 * part.ravel() for part in (felt.real, -felt.imag, steep.real, -steep.imag)])
            left = (linear.after @ whitener.T).ravel()
            normal = np.linalg.inv(table.T @ table)
            shifts.append((normal @ (table.T @ left))[2:])
            variances.append(np.diag(normal)[2:])
            sizes.append(np.linalg.norm(motion.felt[:, pole] * amplitude))
        if len(shifts) < 2:
            continue
        shift, variance = np.array(shifts), np.array(variances)
        weight = 1 / variance
        mean = np.sum(weight * shift, axis=0) / weight.sum(axis=0)
        chi2 = float(np.sum(weight * (shift - mean) ** 2))
        freedom = 2 * (len(shifts) - 1)
        chance = float(chdtrc(freedom, chi2))
        if chance < least:
            least = chance
            value = motion.poles[pole]
            spread = np.ptp(shift, axis=0)
            slope = float(np.polyfit(np.log(sizes), shift[:, 0], 1)[0]) if np.ptp(np.log(sizes)) > 0 else 0.0
            worst = TapScatter(
                number,
                chi2,
                freedom,
                float(spread[1] / abs(value.imag)),
                float(spread[0] / abs(value.real)),
                slope < 0,
            )
    return worst


def unequal_taps(scatter: TapScatter, frequency: float, component: str) -> Doubt:
    """Return the doubt that taps of different strength disagree."""
    text = (
        f"the taps disagree about the mode at {frequency:.4g} Hz: by {percent_text(scatter.frequency, most=1.0)} in "
        f"its frequency and {percent_text(scatter.damping, most=FROM_DAMPING)} in its damping, which is "
        f"{'larger' if scatter.stronger else 'smaller'} after stronger taps; the uncertainties contain half of that"
    )
    advice = "look for friction, a loose joint, cables that touch; tap as strongly as the loads of the test are"
    return Doubt("amplitude dependence", component, text, advice, scatter.damping / 2, "1")
