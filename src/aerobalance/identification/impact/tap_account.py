"""The account of taps: what was found of each, of the force, and what it excited."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from aerobalance.identification.coupled.combinations import pairs
from aerobalance.identification.coupled.conclusions import excitation_of, residual_size
from aerobalance.identification.coupled.units import Units
from aerobalance.identification.impact.response import responses_of
from aerobalance.identification.impact.tap_doubts import late_force
from aerobalance.identification.impact.tap_fit import TapFit
from aerobalance.identification.impact.tap_model import after_contact
from aerobalance.identification.impact.tap_point import TapPoint, fit_point
from aerobalance.identification.impact.tap_record import FoundTap, TapRecord
from aerobalance.identification.impact.tap_result import TapFound, Taps
from aerobalance.identification.impact.tap_stages import PlacedTap
from aerobalance.recording.channel import Array
from aerobalance.recording.doubts import Doubt

BANDWIDTH: Final = 0.1
"""Spectrum of a force over that at zero that ends its bandwidth."""


def excitation_of_taps(fit: TapFit) -> tuple[Array, Array]:
    """How strongly every tap excites every mode, as `excitation_of` has it, (taps, modes) each."""
    motion = fit.motion
    parts = [
        (
            after_contact(tap, motion, fit.common, own=own, point=fit.points[tap.point], off=fit.off[tap.point]),
            tap.time[tap.before :],
        )
        for tap, own in zip(fit.taps, fit.own, strict=True)
    ]
    return excitation_of(parts, motion, fit.noise)


def account_of(
    fit: TapFit,
    units: Units,
    taps: Sequence[PlacedTap],
    records: Sequence[TapRecord],
    places: Sequence[TapPoint | None],
    *,
    doubts: list[Doubt],
    component: str,
    scale: float,
) -> Taps:
    """Return what was found of all taps, those left out too.

    Parameters
    ----------
    fit, units
        The fit.
    taps, records, places
        The taps that it used, the records they are in, and where they were given.
    doubts
        What is doubted so far.
    component
        Component that doubts are about.
    scale
        Loads of the points of the fit over those stated [1].
    """
    shares = excitation_of_taps(fit)[0]
    used = {id(tap.found): number for number, tap in enumerate(taps)}
    found = []
    for record, point in ((record, _point_in(record, taps)) for record in records):
        for tap in record.taps:
            number = used.get(id(tap))
            found.append(
                _tap_found(
                    record,
                    tap,
                    point,
                    shares=None if number is None else shares[number],
                    number=number,
                    fit=fit,
                )
            )
    gain, delay = None, None
    if any(tap.linked for tap in fit.taps):
        root = np.linalg.pinv(fit.shared)
        u = np.sqrt(np.sum(root**2, axis=1))
        gain = scale * (1 + fit.common.gain * fit.common.u_gain), abs(scale) * float(u[0]) * fit.common.u_gain
        unit = fit.common.u_delay / units.rate
        delay = fit.common.delay * unit, float(u[1]) * unit
        rate = records[0].rate
        doubts = doubts + late_force(fit, rate=rate, u_delay=delay[1], delay=delay[0], component=component)
    deviation, reduced = residual_size(
        fit.residuals,
        degrees_of_freedom=fit.degrees_of_freedom,
        sizes=units.sizes,
        noises=[record.noise for record in records],
    )
    return Taps(
        taps=tuple(found),
        points=tuple(fit_point(place, ("AF",), np.ones(1)).name if place is None else str(place) for place in places),
        gain=gain,
        delay=delay,
        corner=max(record.corner for record in records),
        responses=responses_of(fit, units),
        residual_deviation=deviation,
        reduced_chi2=reduced,
        degrees_of_freedom=fit.degrees_of_freedom,
        doubts=tuple(doubts),
    )


def _point_in(record: TapRecord, taps: Sequence[PlacedTap]) -> int:
    return next((tap.point for tap in taps if tap.record is record), -1)


def _tap_found(
    record: TapRecord, tap: FoundTap, point: int, *, shares: Array | None, number: int | None, fit: TapFit
) -> TapFound:
    instant = record.instant(tap)
    level = np.abs(np.fft.rfft(tap.force, 16 * max(tap.force.size, 64)))
    low = np.flatnonzero(level < BANDWIDTH * level[0])
    bandwidth = record.rate / 2 if not low.size else float(low[0]) * record.rate / (16 * max(tap.force.size, 64))
    used = "nothing"
    if number is not None:
        used = "force and ringing" if fit.taps[number].linked else "ringing"
    return TapFound(
        name=f"{record.name} at {instant:.4g} s",
        instant=instant,
        point=point,
        peak=tap.peak,
        impulse=float(tap.force.sum()) / record.rate,
        duration=(tap.contact[1] - tap.contact[0] + 1) / record.rate,
        bandwidth=bandwidth,
        used=used,
        shares=np.full(pairs(fit.motion)[0].size, np.nan) if shares is None else shares,
    )
