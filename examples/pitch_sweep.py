"""
A static polar from one sweep
=============================

The model pitches from -4 to 12 degrees in less than two seconds without a stop, about a
point 0.3 m aft of the balance, on a sting that shakes at some m/s². Weight, inertia,
centrifugal load and ringing come off by the mass and the measured motion. A polar that
is straight from degree to degree is fitted to what is left, and says how well each
point of it is known: for the noise of the sensors, and for the buffeting that fell on
this degree by chance.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import aerobalance as ab
from aerobalance.recording.components import COMPONENTS, MOMENTS
from aerobalance.recording.frames import ResolvedLoads, coefficients, wind_loads
from aerobalance.simulation import (
    Band,
    SixComponentRig,
    broadband,
    random_balance,
    random_motion,
)
from aerobalance.simulation.six_signals import BaseMotion
from aerobalance.uncertainty.regression import regress

SEED = 1
RATE, DURATION = 2500.0, 2.0  # Hz, s
HOLD = 0.15  # rest before and after the sweep [s]
FIRST, LAST, LEVER = np.radians(-4.0), np.radians(12.0), 0.3  # rad, m
WIND = {"pressure": 20e3, "area": 0.03, "chord": 0.1, "span": 0.3}  # Pa, m^2, m
LENGTHS = np.array([1, WIND["chord"], 1, WIND["span"], WIND["span"], 1])
FULL = WIND["pressure"] * WIND["area"] * LENGTHS  # what coefficients of 1 stand for
BUFFETING = 0.01  # rms of the coefficients, 0-200 Hz
KNOTS = np.radians(np.arange(-3.0, 11.5, 1.0))

generator = np.random.default_rng(SEED)

# %%
# The truth: coefficients and motion
# ----------------------------------
# The sweep starts and stops without a jerk: a polynomial of fifth order between two
# rests.


def polar(alpha):
    """Coefficients of the loads in body axes at angles of attack, shape (n, 6)."""
    found = np.zeros((alpha.size, 6))
    found[:, COMPONENTS.index("NF")] = 4.0 * alpha + 12.0 * alpha**3
    found[:, COMPONENTS.index("PM")] = -0.6 * alpha
    found[:, COMPONENTS.index("AF")] = 0.03 + 0.4 * alpha**2
    return found


def turn(time, order):
    """Angle since the start of the sweep, or a derivative of it."""
    length = DURATION - 2 * HOLD
    course = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6]).deriv(order)  # 0 to 1
    part = np.clip((time - HOLD) / length, 0, 1)
    return (LAST - FIRST) / length**order * course(part)


def pitching(values):
    """Turning in pitch alone."""
    return np.outer(values, np.array(MOMENTS) == "PM")


def acceleration(time):
    """Six accelerations of the ground end: pushed along, turned, drawn to the axis."""
    rate, change = turn(time, 1), turn(time, 2)
    return np.column_stack(
        [LEVER * change, change, 0 * rate, 0 * rate, 0 * rate, LEVER * rate**2]
    )


sweep = BaseMotion(
    acceleration,
    lambda time: pitching(turn(time, 1)),
    lambda time: pitching(FIRST + turn(time, 0)),
)

# %%
# The test
# --------

balance = random_balance(generator)
shaking = random_motion(
    generator, Band(5, 60), rms=np.array([2, 1, 2, 1, 1, 2]), period=2 * DURATION
)
motion = sweep.with_motion(shaking)
buffeting = broadband(
    generator, Band(0, 200), rms=BUFFETING * FULL, period=2 * DURATION
)


def aerodynamic(time):
    """Loads of the flow."""
    return FULL * polar(motion.angle(time)[:, MOMENTS.index("PM")]) + buffeting(time)


rig = SixComponentRig(
    balance, applied=aerodynamic, base=motion, output="loads", turning="rate", rate=RATE
)
recording = rig.run(DURATION, generator).recording

# %%
# From readings to the polar
# --------------------------
# The regressors are hats over the knots, so that their coefficients are the loads at
# the knots. Loads along the body become lift and drag at the angle of attack of each.

forces = ab.estimate_force(
    recording, replace(balance.dynamics, mass=balance.mass), bandwidth=100.0
)
pitch = recording.channel("pitch").values
inside = np.flatnonzero((pitch >= KNOTS[0]) & (pitch <= KNOTS[-1]))
hats = {f"{knot:.4f} rad": np.interp(pitch, KNOTS, knot == KNOTS) for knot in KNOTS}
fits = [
    regress(force, hats, span=slice(int(inside[0]), int(inside[-1]) + 1))
    for force in forces.values()
]
values, u = (
    np.column_stack([getattr(fit, what) for fit in fits])
    for what in ("values", "uncertainty")
)

# The customary way, for comparison: readings less the weight at each pitch, averaged
# within half a degree of each knot.
tared = np.column_stack(
    [recording.channel(name).values for name in COMPONENTS]
) - balance.mass.weight(pitch)
raw = np.array(
    [tared[np.abs(pitch - knot) < np.radians(0.5)].mean(axis=0) for knot in KNOTS]
)

body = (
    ResolvedLoads.of(values, uncertainty=u),
    ResolvedLoads.of(FULL * polar(KNOTS)),
    ResolvedLoads.of(raw),
)
found, truth, reading = (
    coefficients(wind_loads(loads, angle_of_attack=KNOTS), **WIND) for loads in body
)
sides = truth.values, found.values, found.uncertainty, reading.values
results = {
    name: [side[:, COMPONENTS.index(load)] for side in sides]
    for name, load in (("CL", "NF"), ("CD", "AF"), ("Cm", "PM"))
}
for name in ("CL", "CD"):
    print(f"alpha [deg]    {name} truth     found        u   reading")
    for angle, *row in zip(np.degrees(KNOTS), *results[name], strict=True):
        print("{:8.2f} {:13.4f} {:9.4f} {:8.4f} {:9.4f}".format(angle, *row))

# %%
# The readings scatter by the shaking that fell into each degree.

_, panels = plt.subplots(1, 2, figsize=(7, 3.8), layout="constrained")
for panel, name in zip(panels, ("CL", "CD"), strict=True):
    exact, value, spread, customary = results[name]
    angle, dots = np.degrees(KNOTS), {"fmt": "o", "ms": 3, "capsize": 2}
    panel.plot(angle, customary, "x", color="0.45", label="readings less weight")
    panel.plot(angle, exact, color="C3", lw=1, label="truth")
    panel.errorbar(angle, value, 2 * spread, label="sweep, with 95 %", **dots)
    panel.set(xlabel="angle of attack [deg]", ylabel=name)
panels[0].legend()
plt.show()

# %%
# What is claimed
# ---------------
# A polar of curvature c″ that is straight over steps h is off by c″h²/8 at most. But
# for that, every point of the three is within six standard uncertainties of the truth:
# those are judged from what buffeting left.

step = KNOTS[1] - KNOTS[0]
curvature = {"CL": 72 * np.max(np.abs(KNOTS)), "CD": 14.0, "Cm": 1.0}
for name, (exact, value, spread, _) in results.items():
    straight = curvature[name] * step**2 / 8
    assert (np.abs(value - exact) < 6 * spread + straight).all(), name
