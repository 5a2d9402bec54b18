"""The static polar from one continuous pitch sweep of two seconds, gravity and inertia taken off.

The model pitches from -4 to 12 degrees without a stop, about a point 0.3 m aft of the balance, on a sting that shakes.
`estimate_force` takes weight, inertia and ringing off; `regress` then fits a polar that is straight from degree
to degree, and says how well each point of it is known: for the noise of the sensors, and for the buffeting that fell
on this degree by chance. Body loads become lift and drag coefficients at the angle of attack of each point.

    python examples/pitch_sweep.py --figure pitch_sweep.png
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from aerobalance.estimation.force import estimate_force
from aerobalance.recording.components import COMPONENTS, MOMENTS
from aerobalance.recording.frames import ResolvedLoads, coefficients, wind_loads
from aerobalance.simulation import Band, SixComponentRig, broadband, random_balance, random_motion
from aerobalance.simulation.six_signals import BaseMotion
from aerobalance.uncertainty.regression import regress

RATE, DURATION, HOLD = 2500.0, 2.0, 0.15  # Hz, s, and s of rest before and after the sweep
FIRST, LAST, LEVER = np.radians(-4.0), np.radians(12.0), 0.3  # rad, m
WIND = {"pressure": 20e3, "area": 0.03, "chord": 0.1, "span": 0.3}  # Pa, m^2, m
FULL = WIND["pressure"] * WIND["area"] * np.array([1, WIND["chord"], 1, WIND["span"], WIND["span"], 1])
KNOTS = np.radians(np.arange(-3.0, 11.5, 1.0))


def polar(alpha):
    """The truth: coefficients of the loads in body axes at angles of attack, shape (n, 6)."""
    found = np.zeros((alpha.size, 6))
    found[:, COMPONENTS.index("NF")] = 4.0 * alpha + 12.0 * alpha**3
    found[:, COMPONENTS.index("PM")] = -0.6 * alpha
    found[:, COMPONENTS.index("AF")] = 0.03 + 0.4 * alpha**2
    return found


def sweep():
    """Pitch that starts and stops without a jerk: a polynomial of fifth order between two rests."""
    length = DURATION - 2 * HOLD
    course = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])  # 0 to 1

    def turn(order):
        law, scale = course.deriv(order), (LAST - FIRST) / length**order
        return lambda time: scale * law(np.clip((time - HOLD) / length, 0, 1))

    def pitching(values):
        return np.outer(values, np.array(MOMENTS) == "PM")

    def acceleration(time):
        rate, change = turn(1)(time), turn(2)(time)
        return np.column_stack([LEVER * change, change, 0 * rate, 0 * rate, 0 * rate, LEVER * rate**2])

    return BaseMotion(acceleration, lambda time: pitching(turn(1)(time)), lambda time: pitching(FIRST + turn(0)(time)))


def main(seed=1, *, figure=None):
    generator = np.random.default_rng(seed)
    balance = random_balance(generator)
    shaking = random_motion(generator, Band(5, 60), rms=np.array([2, 1, 2, 1, 1, 2]), period=2 * DURATION)
    motion = sweep().with_motion(shaking)
    buffeting = broadband(generator, Band(0, 200), rms=0.01 * FULL, period=2 * DURATION)

    def aerodynamic(time):
        return FULL * polar(motion.angle(time)[:, MOMENTS.index("PM")]) + buffeting(time)

    rig = SixComponentRig(balance, applied=aerodynamic, base=motion, output="loads", turning="rate", rate=RATE)
    recording = rig.run(DURATION, generator).recording

    forces = estimate_force(recording, replace(balance.dynamics, mass=balance.mass), bandwidth=100.0)
    pitch = recording.channel("pitch").values
    inside = np.flatnonzero((pitch >= KNOTS[0]) & (pitch <= KNOTS[-1]))
    span = slice(int(inside[0]), int(inside[-1]) + 1)
    hats = {f"{knot:.4f} rad": np.interp(pitch, KNOTS, knot == KNOTS) for knot in KNOTS}
    fits = [regress(force, hats, span=span) for force in forces.values()]
    values, u = (np.column_stack([getattr(fit, what) for fit in fits]) for what in ("values", "uncertainty"))

    # The customary way: readings less the weight at each pitch, averaged within half a degree of each knot.
    tared = np.column_stack([recording.channel(name).values for name in COMPONENTS]) - balance.mass.weight(pitch)
    raw = np.array([tared[np.abs(pitch - knot) < np.radians(0.5)].mean(axis=0) for knot in KNOTS])

    body = (ResolvedLoads.of(values, uncertainty=u), ResolvedLoads.of(FULL * polar(KNOTS)), ResolvedLoads.of(raw))
    found, truth, reading = (coefficients(wind_loads(loads, angle_of_attack=KNOTS), **WIND) for loads in body)
    results = {"alpha": KNOTS}
    print("alpha [deg]    CL truth   found       u  reading      CD truth   found       u  reading")
    for name, column in (("CL", COMPONENTS.index("NF")), ("CD", COMPONENTS.index("AF")), ("Cm", 1)):
        sides = (found.values, found.uncertainty, truth.values, reading.values)
        results[name] = tuple(side[:, column] for side in sides)
    for row, angle in enumerate(np.degrees(KNOTS)):
        parts = [[results[name][side][row] for side in (2, 0, 1, 3)] for name in ("CL", "CD")]
        print(f"{angle:8.2f}   " + "   ".join("{:10.4f} {:8.4f} {:7.4f} {:8.4f}".format(*part) for part in parts))
    if figure:
        draw(figure, results)
    return results


def draw(path, results):
    picture = Figure(figsize=(8, 3.8), layout="constrained")
    panels = picture.subplots(1, 2)
    angle = np.degrees(results["alpha"])
    for panel, name in zip(panels, ("CL", "CD"), strict=True):
        value, u, truth, raw = results[name]
        panel.plot(angle, raw, "x", color="0.45", label="readings less weight")
        panel.plot(angle, truth, color="C3", lw=1, label="truth")
        panel.errorbar(angle, value, 2 * u, fmt="o", ms=3, color="C0", capsize=2, label="sweep, with 95 %")
        panel.set(xlabel="angle of attack [deg]", ylabel=name)
    panels[0].legend()
    picture.savefig(path, dpi=80, metadata={"Software": None}, pil_kwargs={"optimize": True})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figure", type=Path, help="PNG file to draw to")
    main(figure=parser.parse_args().figure)
