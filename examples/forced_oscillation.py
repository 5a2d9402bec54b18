"""Static and damping derivatives from a forced oscillation in pitch and yaw, while the sting shakes.

The sting turns the model in pitch at 7 Hz and in yaw at 11 Hz at once, and shakes. What the balance reads is mostly
the model's inertia, and all of it is a little magnified because 11 Hz is not zero beside the first mode.
`estimate_force` undoes both; the moments applied are then regressed on angles and rates of turn:

    PM = C0 + C_theta theta + C_q theta' + C_psi psi + C_r psi'

Buffeting stays in what the regression leaves over. Its spectrum says how much of it fell on the derivatives by chance.

    python examples/forced_oscillation.py --figure forced_oscillation.png
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.integrate import cumulative_trapezoid

from aerobalance.estimation.force import estimate_force
from aerobalance.motion.platform import PlatformMotion
from aerobalance.recording.components import COMPONENTS, MOMENTS
from aerobalance.simulation import Band, SixComponentRig, broadband, oscillation, random_balance, random_motion
from aerobalance.uncertainty.regression import regress

RATE, DURATION = 2500.0, 2.0  # Hz, s: 14 cycles of pitch, 22 of yaw
BANDWIDTH = 80.0  # far above both, so that nothing of the derivatives is lost [Hz]
INNER = slice(250, -250)  # the force is less sure in the first and last 0.1 s, where the record breaks off
PITCH, YAW = np.radians(3.0), np.radians(3.0)  # amplitudes [rad]
SHAKING = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0])  # rms of the sting's accelerations, 5-60 Hz [m/s^2, rad/s^2]

# The truth: derivatives of the moments by angle [N*m/rad] and by rate of turn [N*m*s/rad].
TRUTH = {"PM": {"pitch": -400.0, "pitch rate": -6.0}, "YM": {"yaw": 250.0, "yaw rate": -4.0}}


def motion_of(rate, frequency):
    """Angles and rates of turn in pitch and yaw as the regressors; the angles begin at zero, C0 takes the rest."""
    pitch_rate, yaw_rate = rate[:, MOMENTS.index("PM")], rate[:, MOMENTS.index("YM")]
    angles = [cumulative_trapezoid(turn, dx=1 / frequency, initial=0) for turn in (pitch_rate, yaw_rate)]
    return {"constant": 1.0, "pitch": angles[0], "pitch rate": pitch_rate, "yaw": angles[1], "yaw rate": yaw_rate}


def simulated(balance, generator, *, wind):
    """One run: motion of the sting, and with wind on, moments that follow the motion, and buffeting."""
    motion = oscillation("PM", amplitude=PITCH, frequency=7.0, lever=0.2)
    motion = motion.with_motion(oscillation("YM", amplitude=YAW, frequency=11.0, lever=0.2))
    motion = motion.with_motion(random_motion(generator, Band(5, 60), rms=SHAKING, period=2 * DURATION))
    buffeting = broadband(generator, Band(0, 200), rms=0.001 * balance.half_range, period=2 * DURATION)

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
        balance, applied=aerodynamic if wind else None, base=motion, output="loads", turning="rate", rate=RATE
    )
    return rig.run(DURATION, generator).recording


def main(seed=1, *, figure=None):
    generator = np.random.default_rng(seed)
    balance = random_balance(generator)
    wind_on, wind_off = (simulated(balance, generator, wind=wind) for wind in (True, False))

    forces = estimate_force(wind_on, replace(balance.dynamics, mass=balance.mass), bandwidth=BANDWIDTH)
    motion = motion_of(PlatformMotion.of(wind_on).turn_rate, RATE)
    fits = {moment: regress(forces[moment], motion, span=INNER) for moment in TRUTH}

    # The customary way, for comparison: readings on the same regressors, less those of a wind-off run.
    raw = {moment: _readings_on_motion(wind_on, moment) - _readings_on_motion(wind_off, moment) for moment in TRUTH}

    results = {}
    print("derivative          truth      found        u   readings less wind-off")
    for moment, derivatives in TRUTH.items():
        for name, truth in derivatives.items():
            value, u = fits[moment].of(name)
            customary = float(raw[moment][list(motion).index(name)])
            results[f"{moment} by {name}"] = (value, u, truth, customary)
            print(f"{moment} by {name:10s} {truth:10.3f} {value:10.3f} {u:8.3f} {customary:10.3f}")
    if figure:
        draw(figure, wind_on, forces, motion, fits)
    return results


def _readings_on_motion(recording, moment):
    columns = motion_of(PlatformMotion.of(recording).turn_rate, RATE)
    matrix = np.column_stack([np.broadcast_to(column, recording.samples) for column in columns.values()])
    return np.linalg.lstsq(matrix[INNER], recording.channel(moment).values[INNER])[0]


def draw(path, recording, forces, motion, fits):
    picture = Figure(figsize=(8, 3.8), layout="constrained")
    panels = picture.subplots(1, 2)
    for panel, (moment, name) in zip(panels, (("PM", "pitch"), ("YM", "yaw")), strict=True):
        angle = np.degrees(motion[name] - motion[name].mean())[INNER]
        reading, applied = recording.channel(moment).values[INNER], forces[moment].values[INNER]
        fitted = applied - fits[moment].residual
        panel.plot(angle, reading - reading.mean(), color="C1", lw=0.6, label="reading")
        panel.plot(angle, applied - applied.mean(), color="C0", lw=3, label="applied, recovered")
        panel.plot(angle, fitted - applied.mean(), color="k", lw=0.7, label="derivatives x motion")
        panel.set(xlabel=f"{name} [deg]", ylabel=f"{moment} less its mean [N m]")
    panels[0].legend(fontsize="small")
    picture.savefig(path, dpi=80, metadata={"Software": None}, pil_kwargs={"optimize": True})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figure", type=Path, help="PNG file to draw to")
    main(figure=parser.parse_args().figure)
