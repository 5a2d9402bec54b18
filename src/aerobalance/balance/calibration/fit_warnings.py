"""Warnings of weaknesses of a calibration that its residuals do not show."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from aerobalance.balance.calibration.fit import Calibration
from aerobalance.balance.calibration.outliers import outlier_text
from aerobalance.balance.calibration.quality import Quality
from aerobalance.balance.calibration.regression import HIGHEST_INFLATION, inflation_text
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.recording.errors import argument, warn_quality

TOO_QUIET: Final = 1e-6
"""Probability, over all bridges together, below which the readings' scatter is less than the noise given for them."""


def warn_of_weaknesses(calibration: Calibration, quality: Quality) -> None:
    """Warn of weaknesses of the matrix that its residuals do not show."""
    schedule, matrix = calibration.schedule, calibration.matrix
    if quality.outliers:
        worst = quality.outliers[0]
        count = len(quality.outliers)
        _warn(
            f"{schedule.name}: {f'{count} readings do' if count > 1 else '1 reading does'} not go with the others, "
            f"{'most ' if count > 1 else ''}{outlier_text(schedule, worst)}; "
            f"{'they are' if count > 1 else 'it is'} in the fit and {'widen' if count > 1 else 'widens'} its "
            f"uncertainty. What is wrong is left out with {argument('Schedule.without', [worst.label])}"
        )
    if calibration.unidentified:
        labels = calibration.unidentified_labels
        _warn(
            f"{schedule.name}: the schedule cannot identify {len(labels)} terms, which are left out: "
            f"{', '.join(labels[:6])}{' ...' if len(labels) > 6 else ''}. Loads that would bring them out have an "
            "error that the uncertainty does not show"
        )
    one_way = [name for name, d in zip(schedule.components, quality.directions, strict=True) if not d.known]
    if one_way:
        _warn(
            f"{schedule.name}: {', '.join(one_way)} loaded in one direction only; whether the bridge is bidirectional "
            "is not known, and loads the other way are extrapolated"
        )
    missed = [
        (name, 100 * d.difference)
        for i, (name, d) in enumerate(zip(schedule.components, quality.directions, strict=True))
        if d.bidirectional and not _has_direction(matrix, calibration.regressions[i].included, i)
    ]
    if missed:
        texts = ", ".join(f"{name} ({difference:+.2g} %)" for name, difference in missed)
        _warn(
            f"{schedule.name}: bridges with different sensitivities to + and - loads: {texts}; the model has no term "
            f"for that. Use {argument('model')} abs, 96 or auto"
        )
    inflated = [float(np.nanmax(fit.vif)) for fit in calibration.regressions]
    if max(inflated) > HIGHEST_INFLATION and calibration.model != "auto":
        _warn(
            f"{schedule.name}: some terms are near copies of each other (variance inflation factor up to "
            f"{inflation_text(max(inflated))}, above {HIGHEST_INFLATION:g}); their coefficients mean little one by "
            f"one. {argument('model', 'auto')} keeps of them what the readings support"
        )
    _warn_of_reading_noise(calibration)


def _warn_of_reading_noise(calibration: Calibration) -> None:
    """Warn where the stated noise of the readings is more than their scatter."""
    schedule, matrix = calibration.schedule, calibration.matrix
    noise, found, freedom = matrix.noise_of_readings, matrix.residual_deviation, matrix.degrees_of_freedom
    half = np.maximum(freedom, 1) / 2
    least = noise * np.sqrt(gammaincinv(half, TOO_QUIET / noise.size) / half)
    quiet = np.flatnonzero(found < least)
    if quiet.size:
        given = np.broadcast_to(matrix.reading_noise, noise.shape)
        by_bridge = matrix.way == "iterative"
        texts = ", ".join(
            f"{f'r{matrix.gauges[i]}' if by_bridge else schedule.components[i]} {found[i] / noise[i]:.2g} times"
            + (f" the {given[i]:g} mV/V" if by_bridge else " what the bridges' noise makes of it")
            for i in quiet
        )
        each = np.ndim(matrix.reading_noise) == 0 and quiet.size < noise.size
        by_each = f". Where bridges differ, give each its own: {argument('reading_noise', {'rNAME': ...})}"
        _warn(
            f"{schedule.name}: readings scatter less about the matrix than the noise given for them: {texts}. "
            "That noise is too large, or not of these readings; their scatter counts for nothing in the "
            f"uncertainty of the loads{by_each if each else ''}"
        )


def _has_direction(matrix: BalanceMatrix, included: NDArray[np.bool_], index: int) -> bool:
    """Whether the model of a component has a term that can stand for its direction: |F|, F*F or |F*F*F|."""
    return any(
        used and term.first == term.second == index and term.kind in (1, 2, 9)
        for term, used in zip(matrix.terms, included, strict=True)
    )


def _warn(text: str) -> None:
    warn_quality(text)
