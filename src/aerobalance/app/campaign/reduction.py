"""One run of a test reduced: from its recording to loads, forces and what sums them up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from aerobalance.app.campaign.definition import (
    Axes,
    Definition,
    ForceOptions,
    Pressure,
    Reference,
    SpectrumBands,
)
from aerobalance.app.campaign.run_table import PRESSURES
from aerobalance.balance.calibration.fit import Calibration
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.reduction import reduction_of
from aerobalance.balance.zero_levels import ZeroLevel, zero_levels
from aerobalance.balance.zeros import Zero
from aerobalance.dynamics.independent import AnyDynamics, dynamics_of
from aerobalance.estimation.applied_force import Force
from aerobalance.estimation.checks.resonance_change import ResonanceChange, resonance_changes
from aerobalance.estimation.force import ForceWork
from aerobalance.estimation.forces import ForceSettings
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import STANDARD_GRAVITY
from aerobalance.recording.frames import Frame, angles_of_attitude
from aerobalance.recording.recording import Recording
from aerobalance.uncertainty.budget import BandLevel, Scalar, band_levels, scalars
from aerobalance.uncertainty.mean_in_axes import Flow, MeanInAxes, ReferenceSizes, mean_in_axes
from aerobalance.uncertainty.mean_loads import MeanLoads, mean_loads

ANGLE_STEP: Final = 1e-6
"""Step of the central differences by which angles are differentiated [rad]."""


@dataclass(frozen=True, slots=True)
class RunSettings:
    """How a run is reduced.

    Attributes
    ----------
    force
        How the force is worked out.
    axes
        Axes of the body in the balance, and moment centre in the body.
    reference
        Area and lengths of coefficients; None for none.
    pressure
        Where the dynamic pressure is from; None where it is not known.
    alpha, beta
        Columns of the angles; None for those of the recording, where no column is called so.
    u_angle, u_angle_run
        Standard uncertainty of the angles, the same error in all runs, and drawn anew in each [deg].
    bands
        Bands whose rms is wanted [Hz].
    """

    force: ForceSettings = field(default_factory=ForceSettings)
    axes: Axes = field(default_factory=Axes)
    reference: Reference | None = None
    pressure: Pressure | None = None
    alpha: str | None = None
    beta: str | None = None
    u_angle: float = 0.0
    u_angle_run: float = 0.0
    bands: Sequence[tuple[float, float]] = field(default_factory=lambda: SpectrumBands().bands)

    @classmethod
    def of(cls, definition: Definition, axes: Axes) -> RunSettings:
        """Take what the definition of a test says."""
        return cls(
            force=force_settings(definition.force, gravity=definition.gravity),
            axes=axes,
            reference=definition.reference,
            pressure=definition.pressure,
            alpha=definition.angles.alpha,
            beta=definition.angles.beta,
            u_angle=definition.angles.u,
            u_angle_run=definition.angles.u_run,
            bands=definition.spectrum.bands,
        )


def force_settings(options: ForceOptions, *, gravity: float = STANDARD_GRAVITY) -> ForceSettings:
    """Return how a force is worked out, as a test file says it."""
    hum = options.hum if isinstance(options.hum, str) else tuple(options.hum)
    return ForceSettings(
        options.method, options.bandwidth, gravity, options.u_gravity, hum, options.keep_outliers, options.align
    )


@dataclass(frozen=True, slots=True, eq=False)
class ReducedRun:
    """A run reduced.

    Attributes
    ----------
    force
        The forces applied, with the loads that they are from, verdict and doubts.
    mean
        Mean force in the balance's axes.
    axes
        The same in ``body`` and ``wind`` axes about the moment centre, and ``C_body`` and ``C_wind`` coefficients.
    flow
        Angles and dynamic pressure.
    scalars
        Mean, rms about it, largest and least of each force as it was in this record, by component and name.
    bands
        Rms in bands, by component.
    resonances
        What the record says of stiffness and damping.
    zero
        What the loads count from, as loads of the balance; empty where loads were recorded.
    """

    force: Force
    mean: MeanLoads
    axes: Mapping[str, MeanInAxes]
    flow: Flow
    scalars: Mapping[str, Mapping[str, Scalar]]
    bands: Mapping[str, tuple[BandLevel, ...]]
    resonances: tuple[ResonanceChange, ...]
    zero: tuple[ZeroLevel, ...]


def reduce_run(
    run: Recording,
    dynamics: AnyDynamics,
    *,
    balance: BalanceMatrix | Calibration | None = None,
    zero: Zero | None = None,
    tare: Sequence[Recording] = (),
    noise: Recording | None = None,
    columns: Mapping[str, object] | None = None,
    settings: RunSettings | None = None,
) -> ReducedRun:
    """Loads and forces of a run [N, N*m] with their uncertainty, and one number each that sum them up.

    Parameters
    ----------
    run
        Balance loads, or with `balance` gauge outputs.
    dynamics, balance, zero
        As in `aerobalance.estimate_force`.
    tare
        Wind-off recordings whose loads are taken off at the same attitude.
    noise
        A record of noise alone, read as the run is.
    columns
        What else is known of the run, such as ``alpha`` [deg].
    settings
        How it is reduced.

    Raises
    ------
    FitError, ValueError
        As `aerobalance.estimate_force`; the dynamic pressure or an angle is asked for and not there.
    """
    settings = RunSettings() if settings is None else settings
    columns = {} if columns is None else columns
    model = dynamics_of(dynamics)
    gravity = settings.force.gravity
    means = {name: float(np.nanmean(one.values)) for name, one in run.channels.items() if not one.missing.all()}
    pressure, u_pressure = pressure_of(settings.pressure, columns, run)  # before the long work
    u_attitude = {
        f"{name} {what}": u
        for name in ("pitch", "roll")
        if name in means
        for what, u in zip(("zero", "gain"), _held(run.channel(name)), strict=True)
    }
    flow = flow_of(columns, means, settings, u_attitude=u_attitude)
    flow = replace(flow, pressure=pressure, u_pressure=u_pressure)

    made_ready = reduction_of(balance, zero=zero, model=model, tare=tare, gravity=gravity)
    calm = None if noise is None else made_ready(noise)
    force = ForceWork(run, model, made_ready=made_ready, noise=calm, settings=settings.force).force()
    mean = mean_loads(force)
    whole = all(part.summary is None for part in force.values())
    loads = force.loads if balance is not None else None
    return ReducedRun(
        force=force,
        mean=mean,
        axes=mean_in_axes(mean, frames=frames_of(settings.axes), flow=flow, reference=sizes_of(settings.reference)),
        flow=flow,
        scalars={name: {one.name: one for one in scalars(part)} for name, part in force.items()},
        bands={name: band_levels(part, settings.bands, rate=run.rate) for name, part in force.items()},
        resonances=resonance_changes(force) if whole and settings.force.method == "smoother" else (),
        zero=() if loads is None else zero_levels(loads),
    )


def frames_of(axes: Axes) -> tuple[Frame, Frame]:
    """Return the body in the balance, and its moment centre in the body, as a test file says them."""
    body = axes.body
    pitch, roll, yaw, u_angle = np.radians([body.pitch, body.roll, body.yaw, body.u_angle]).tolist()
    spread = np.diag([body.u_point**2] * 3 + [u_angle**2] * 3)
    centre = np.diag([axes.u_moment_centre**2] * 3 + [0.0] * 3)
    return Frame(np.array(body.point), pitch, roll, yaw, spread), Frame(
        np.array(axes.moment_centre), covariance=centre
    )


def sizes_of(reference: Reference | None) -> ReferenceSizes | None:
    """Return the reference quantities that a test file says; None for none."""
    return None if reference is None else ReferenceSizes(reference.area, reference.chord, reference.span)


def flow_of(
    columns: Mapping[str, object],
    means: Mapping[str, float],
    settings: RunSettings,
    *,
    u_attitude: Mapping[str, float] | None = None,
) -> Flow:
    """Angles of the body of a run, from its columns or from the means of its channels; no pressure yet.

    The channels have the attitude of the balance; the body's is that and its place in the balance. `u_attitude` is
    what pitch and roll are wrong by in all runs, their standard uncertainties [rad] by the name of the error, whose
    first word is that of the channel: ``pitch zero``.

    Raises
    ------
    ValueError
        A column that is named is not there, or is no number.
    """
    body = frames_of(settings.axes)[0]
    pitch, roll = means.get("pitch", 0.0), means.get("roll", 0.0)
    alpha, beta = angles_of_attitude(pitch, roll, body)
    found = {"alpha": alpha, "beta": beta}
    told = "pitch" in means
    slopes = _slopes_of_attitude(pitch, roll, body)
    for row, (name, wanted) in enumerate((("alpha", settings.alpha), ("beta", settings.beta))):
        key = name if wanted is None else wanted
        if key in columns:
            given = columns[key]
            if not isinstance(given, int | float) or isinstance(given, bool):
                raise ValueError(f"column {key} must be a number of degrees, not {given!r}")
            found[name] = float(np.radians(given))
            slopes[row] = 0.0
            told = True
        elif wanted is not None:
            raise ValueError(f"{name} should be in column {wanted}, which this run does not have")
    errors = {} if u_attitude is None else u_attitude
    columns_of = {"pitch": slopes[:, 0], "roll": slopes[:, 1]}
    by_sensors = {name: u * columns_of[name.split()[0]] for name, u in errors.items() if u}
    return Flow(
        alpha=found["alpha"],
        beta=found["beta"],
        u_angle=float(np.radians(settings.u_angle)),
        u_angle_run=float(np.radians(settings.u_angle_run)),
        u_pressure_run=0.0 if settings.pressure is None else settings.pressure.u_run,
        known=told,
        by_sensors={name: (float(one[0]), float(one[1])) for name, one in by_sensors.items()},
    )


def _slopes_of_attitude(pitch: float, roll: float, body: Frame) -> Array:
    """Derivatives of the angles of the body by pitch and roll of its balance, shape (2, 2) [1]."""

    def by(step: tuple[float, float]) -> Array:
        ahead, behind = (angles_of_attitude(pitch + k * step[0], roll + k * step[1], body) for k in (1, -1))
        return np.array([ahead[0] - behind[0], ahead[1] - behind[1]]) / (2 * ANGLE_STEP)

    return np.column_stack([by((ANGLE_STEP, 0.0)), by((0.0, ANGLE_STEP))])


def _held(channel: Channel) -> tuple[float, float]:
    """What the standard uncertainties of zero and gain of a channel make of its mean, in its unit."""
    return channel.zero_uncertainty, float(channel.relative_uncertainty * np.nanmean(channel.values))


def pressure_of(rule: Pressure | None, columns: Mapping[str, object], run: Recording) -> tuple[float | None, float]:
    """Dynamic pressure of a run and its standard uncertainty that is the same in all [Pa]; None where not asked for.

    Raises
    ------
    ValueError
        The column or the channel is missing, or is no pressure.
    """
    if rule is None:
        return None, 0.0
    if rule.value is not None:
        return rule.value, rule.u
    of_sensor = 0.0
    if rule.column is not None:
        found, where = columns.get(rule.column), f"column {rule.column}"
    else:
        name = rule.channel or ""
        where = f"channel {name}"
        found, of_sensor = _mean_pressure(run.channel(name)) if name in run else (None, 0.0)
    if found is None:
        raise ValueError(f"the dynamic pressure should be in {where}, which this run does not have")
    if not isinstance(found, int | float) or isinstance(found, bool) or not 0 < found < np.inf:
        raise ValueError(f"the dynamic pressure in {where} must be above 0 Pa, not {found!r}")
    return float(found), float(np.hypot(rule.u, of_sensor))


def _mean_pressure(channel: Channel) -> tuple[float | None, float]:
    """Mean of a channel in Pa, as its file has it in its own unit, and its uncertainty; None without a reading."""
    if channel.unit not in PRESSURES:
        raise ValueError(
            f"the dynamic pressure should be in channel {channel.name}, which is in {channel.unit or 'no unit'}; "
            f"allowed: {', '.join(PRESSURES)}"
        )
    if channel.missing.all():
        return None, 0.0
    factor = PRESSURES[channel.unit]
    return factor * float(np.nanmean(channel.values)), factor * float(np.hypot(*_held(channel)))
