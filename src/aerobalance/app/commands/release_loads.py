"""Balance loads in the recordings that dynamics are identified from, where gauge outputs were recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from aerobalance.app.commands.balance_files import BalanceFiles
from aerobalance.balance.matrix_errors import MatrixErrors
from aerobalance.balance.reduction import NotWeighed
from aerobalance.balance.weighing.result import Weighing
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.errors import warn_quality
from aerobalance.recording.recording import Recording


def releases_felt(
    recordings: Sequence[Recording],
    files: BalanceFiles,
    weighing: Weighing | None,
    *,
    channel_map: Path | None,
    counted: bool = True,
) -> tuple[list[Recording], list[MatrixErrors]]:
    """Balance loads in place of gauge outputs, and where the matrix was used for them, release by release.

    What hangs on the balance does not change the ringing. But bridges that are curved ring as where they are, so the
    weight in a zero that was read with the model on is put back, as far as a weighing or natural zeros tell it.

    Parameters
    ----------
    recordings
        Gauge outputs.
    files
        Balance matrix, zeros and tares.
    weighing
        What hangs on the balance; None where it is not known.
    channel_map
        Channel map of the zeros.
    counted
        Whether what the calibration leaves is to be counted, for which the matrix must hold it.
    """
    model = NotWeighed() if weighing is None else weighing
    gravity = STANDARD_GRAVITY if weighing is None else weighing.gravity
    found = [files.loads(recording, model=model, gravity=gravity, channel_map=channel_map) for recording in recordings]
    if counted and not all(loads.balance.covariance.any() for loads in found):
        warn_quality(
            f"{files.balance.name} holds no covariance of its coefficients; what its calibration leaves in the "
            "dynamics is not known"
        )
    return [loads.recording for loads in found], [loads.matrix_errors for loads in found]


def with_sensitivity_error(recording: Recording, component: str, errors: MatrixErrors) -> Recording:
    """Return the recording with what the calibration leaves of a load's sensitivity as uncertainty of its gain."""
    place = errors.components.index(component)
    size = float(np.ptp(recording.channel(component).values)) / 2
    alone = np.asarray(np.linalg.inv(errors.transform)[:, place] * size, dtype=np.float64)
    covariance = errors.matrix.load_covariance(alone[None, :], residual=False)[0]
    own = errors.transform[place]
    relative = float(np.sqrt(max(own @ covariance @ own, 0.0))) / size if size > 0 else 0.0
    channel = recording.channel(component)
    known = replace(channel, relative_uncertainty=float(np.hypot(channel.relative_uncertainty, relative)))
    return replace(recording, channels={**recording.channels, component: known})
