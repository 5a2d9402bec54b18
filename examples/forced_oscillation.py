"""
Derivatives from a forced oscillation
=====================================

The sting turns the model in pitch at 7 Hz and in yaw at 11 Hz at once, and shakes. What
the balance reads is mostly the model's inertia, and all of it is a little magnified
because 11 Hz is not zero beside the first mode. The force that is recovered is free of
both. The moments are then regressed on angles and rates of turn:

    PM = C0 + C_theta θ + C_q θ′ + C_psi ψ + C_r ψ′

Buffeting stays in what the regression leaves over. Its spectrum says how much of it
fell on the derivatives by chance.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import cumulative_trapezoid

import aerobalance as ab
from aerobalance.motion.platform import PlatformMotion
from aerobalance.recording.components import COMPONENTS, MOMENTS
from aerobalance.simulation import (
    Band,
    SixComponentRig,
    broadband,
    oscillation,
    random_balance,
    random_motion,
)
from aerobalance.uncertainty.regression import regress

SEED = 2
RATE, DURATION = 2500.0, 2.0  # Hz, s: 14 cycles of pitch, 22 of yaw
BANDWIDTH = 80.0  # far above both, so that nothing of the derivatives is lost [Hz]
INNER = slice(250, -250)  # where the record breaks off, the force is less sure
PITCH, YAW = np.radians(3.0), np.radians(3.0)  # amplitudes [rad]
SHAKING = np.full(6, 1.0)  # rms of its accelerations, 5-60 Hz [m/s^2, rad/s^2]

# The truth: derivatives of the moments by angle [N*m/rad] and by rate [N*m*s/rad].
TRUTH = {
    "PM": {"pitch": -400.0, "pitch rate": -6.0},
    "YM": {"yaw": 250.0, "yaw rate": -4.0},
}

generator = np.random.default_rng(SEED)

# %%
# Two runs, wind on and wind off
# ------------------------------
# With wind on, the moments follow the motion, and there is buffeting.


def simulated(balance, *, wind):
    """One run."""
    motion = oscillation("PM", amplitude=PITCH, frequency=7.0, lever=0.2)
    motion = motion.with_motion(
        oscillation("YM", amplitude=YAW, frequency=11.0, lever=0.2)
    )
    motion = motion.with_motion(
        random_motion(generator, Band(5, 60), rms=SHAKING, period=2 * DURATION)
    )
    buffeting = broadband(
        generator, Band(0, 200), rms=0.001 * balance.half_range, period=2 * DURATION
    )

    def aerodynamic(time):
        loads = buffeting(time)
        turns = {"pitch": "PM", "yaw": "YM"}
        for moment, derivatives in TRUTH.items():
            for name, value in derivatives.items():
                course = motion.rate if name.endswith("rate") else motion.angle
                turn = course(time)[:, MOMENTS.index(turns[name.split()[0]])]
                loads[:, COMPONENTS.index(moment)] += value * turn
        return loads

    rig = SixComponentRig(
        balance,
        applied=aerodynamic if wind else None,
        base=motion,
        output="loads",
        turning="rate",
        rate=RATE,
    )
    return rig.run(DURATION, generator).recording


balance = random_balance(generator)
wind_on, wind_off = simulated(balance, wind=True), simulated(balance, wind=False)

# %%
# Moments on angles and rates
# ---------------------------
# The force is the band-limited inverse, ``bandwidth=80.0``. A pure tone over buffeting
# is what the smoother's prior is slowest to learn, and far below the first mode there
# is nothing for it to gain. Angles are the integrals of the rates that were measured;
# they begin at zero, and the constant takes the rest.


def motion_of(recording):
    """Angles and rates of turn in pitch and yaw, as the regressors."""
    rate = PlatformMotion.of(recording).turn_rate
    pitch_rate, yaw_rate = rate[:, MOMENTS.index("PM")], rate[:, MOMENTS.index("YM")]
    angles = [
        cumulative_trapezoid(turn, dx=1 / RATE, initial=0)
        for turn in (pitch_rate, yaw_rate)
    ]
    return {
        "constant": 1.0,
        "pitch": angles[0],
        "pitch rate": pitch_rate,
        "yaw": angles[1],
        "yaw rate": yaw_rate,
    }


forces = ab.estimate_force(
    wind_on, replace(balance.dynamics, mass=balance.mass), bandwidth=BANDWIDTH
)
motion = motion_of(wind_on)
fits = {moment: regress(forces[moment], motion, span=INNER) for moment in TRUTH}

# %%
# The customary way, for comparison: readings on the same regressors, less those of the
# wind-off run.


def readings_on_motion(recording, moment):
    """The same derivatives, of readings."""
    columns = [
        np.broadcast_to(column, recording.samples)
        for column in motion_of(recording).values()
    ]
    matrix, readings = np.column_stack(columns), recording.channel(moment).values
    return dict(
        zip(motion, np.linalg.lstsq(matrix[INNER], readings[INNER])[0], strict=True)
    )


results = {}
print("derivative             truth      found        u   readings less wind-off")
for moment, derivatives in TRUTH.items():
    on, off = (
        readings_on_motion(recording, moment) for recording in (wind_on, wind_off)
    )
    for name, truth in derivatives.items():
        results[f"{moment} by {name}"] = (
            *fits[moment].of(name),
            truth,
            on[name] - off[name],
        )
        value, u, _, customary = results[f"{moment} by {name}"]
        numbers = f"{truth:10.3f} {value:10.3f} {u:8.3f} {customary:10.3f}"
        print(f"{moment} by {name:10s} {numbers}")

# %%
# What is read is mostly inertia: it is steeper than what is applied, and in pitch it
# has the other sign. Readings less those of the wind-off run are off by a percent: the
# first modes magnify what happens at 11 Hz, and the shaking is another in the other
# run.

_, panels = plt.subplots(1, 2, figsize=(7, 3.8), layout="constrained")
for panel, (moment, name) in zip(panels, (("PM", "pitch"), ("YM", "yaw")), strict=True):
    angle = np.degrees(motion[name] - motion[name].mean())[INNER]
    reading, applied = (
        wind_on.channel(moment).values[INNER],
        forces[moment].values[INNER],
    )
    fitted = applied - fits[moment].residual
    panel.plot(angle, reading - reading.mean(), color="C1", lw=0.6, label="reading")
    panel.plot(
        angle, applied - applied.mean(), color="C0", lw=3, label="applied, recovered"
    )
    panel.plot(
        angle, fitted - applied.mean(), color="k", lw=0.7, label="derivatives x motion"
    )
    panel.set(xlabel=f"{name} [deg]", ylabel=f"{moment} less its mean [N m]")
panels[0].legend()
plt.show()

# %%
# What is claimed
# ---------------
# Each derivative is within a percent of the truth, and within six of its standard
# uncertainties, which are judged from what buffeting left.

for name, (value, u, truth, _) in results.items():
    assert abs(value / truth - 1) < 0.01, name
    assert abs(value - truth) < 6 * u, name
