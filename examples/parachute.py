"""
The opening shock of a parachute
================================

The canopy fills within some hundredths of a second, its drag shoots over and then
fluctuates. A balance that rings at 45 Hz adds its own overshoot to the canopy's: the
largest reading is no load that the parachute ever had.
"""

import matplotlib.pyplot as plt
import numpy as np

import aerobalance as ab
from aerobalance.simulation import CableCut, Sensor, band_noise
from aerobalance.uncertainty.budget import scalars

SEED = 1
RATE, DURATION = 2000.0, 1.2  # Hz, s
NOISE, BANDWIDTH = 1.0, 150.0  # N per reading, Hz
MASS, NATURAL, RATIO = 20.0, 2 * np.pi * 45, 0.01  # kg, rad/s, damping ratio
BALANCE = ab.Dynamics(
    "AF", mass=MASS, stiffness=MASS * NATURAL**2, damping=2 * RATIO * MASS * NATURAL
)
OPENING, FILLING = 0.3, 0.03  # s
STEADY, OVERSHOOT, SETTLING = 1200.0, 1.8, 0.06  # N, over the steady drag, s

generator = np.random.default_rng(SEED)

# %%
# The drag, and what is read of it
# --------------------------------
# Filling, overshoot, breathing of the canopy at 9 Hz, and turbulence.

turbulence = band_noise(generator, low=0.0, high=120.0, rms=40.0, period=20.0)


def drag(time):
    """Drag over time."""
    since = np.maximum(time - OPENING, 0.0)
    progress = np.clip(since / FILLING, 0, 1)
    filled = progress**3 * (10 - 15 * progress + 6 * progress**2)
    shock = OVERSHOOT * np.exp(-since / SETTLING)
    breathing = 0.06 * np.sin(2 * np.pi * 9 * since)
    return filled * (STEADY * (1 + shock + breathing) + turbulence(time))


rig = CableCut(
    dynamics=BALANCE,
    cable_force=0.0,
    applied=drag,
    rate=RATE,
    sensors={"AF": Sensor(noise=NOISE)},
)
test = rig.run(DURATION, generator)

# %%
# The force
# ---------
# One opening is too little to learn a spectrum from, so the band is given: the canopy
# does little above 150 Hz. The noise that comes with that band is the uncertainty. The
# largest force is one of the numbers that every result is summed up in, with an
# uncertainty of its own.

force = ab.estimate_force(test.recording, BALANCE, bandwidth=BANDWIDTH).only
peak = {scalar.name: scalar for scalar in scalars(force)}["largest"]

time, reading = test.recording.time, test.recording.channel("AF").values
steady = time > OPENING + 0.4
print("                             truth     found        u   reading")
largest = test.applied.max(), peak.value, peak.u, reading.max()
print("peak [N]                 {:9.1f} {:9.1f} {:8.1f} {:9.1f}".format(*largest))
rms = [float(values[steady].std()) for values in (test.applied, force.values, reading)]
print(f"rms of the steady drag [N] {rms[0]:7.1f} {rms[1]:9.1f} {'':8s} {rms[2]:9.1f}")

# %%
# The largest reading is a quarter above the largest drag.

_, (whole, near) = plt.subplots(
    1, 2, width_ratios=(2, 1), figsize=(7, 4), layout="constrained"
)
for panel in (whole, near):
    panel.plot(time, reading, color="C1", lw=0.8, label="reading")
    panel.plot(time, test.applied, color="0.75", lw=3.5, label="drag, truth")
    panel.plot(time, force.values, color="C0", lw=1, label="drag, recovered")
    panel.set_xlabel("time [s]")
place = time[np.argmax(force.values)]
dot = {"fmt": "o", "ms": 4, "color": "k", "capsize": 3}
bars = near.errorbar(place, peak.value, 2 * peak.u, label="peak, 95 %", **dot)
near.set_xlim(OPENING - 0.01, OPENING + 0.1)
whole.set_ylabel("drag [N]")
whole.legend(loc="lower right")
near.legend(handles=[bars], loc="lower right")
plt.show()

# %%
# What is claimed
# ---------------
# The peak is within five standard uncertainties of the truth, where the largest reading
# is more than ten away from it. So is the rms of the drag that follows.

assert abs(peak.value - test.applied.max()) < 5 * peak.u
assert reading.max() - test.applied.max() > 10 * peak.u
assert abs(rms[1] - rms[0]) < 5 * peak.u
