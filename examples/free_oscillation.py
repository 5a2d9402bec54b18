"""
Derivatives from a free oscillation
===================================

The spring of a free-oscillation rig is a balance of one component: it is calibrated,
reads PM, and rings at 5 Hz. A release wind off gives its dynamics. Wind on, Eq. (17)
gives the moment of the flow at every instant of the ring-down, and it goes with angle
and rate of the model:

    PM = C0 + PM_theta θ + PM_q θ′,  θ = reading / stiffness

Buffeting shakes the model as it rings down. The regression tells it apart, and says
what it does to the derivatives.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import aerobalance as ab
from aerobalance.identification.free_decay.fit import identify_decay
from aerobalance.simulation import CableCut, Sensor, band_noise
from aerobalance.uncertainty.regression import regress

SEED = 1
RATE, DURATION, RELEASE = 1000.0, 3.5, 1.0  # Hz, s, s
RELEASES = 4  # wind on
BANDWIDTH = 40.0  # Hz
INNER = slice(150, -150)  # where the record breaks off, the force is less sure
# Of model and live end about the spring's axis [kg*m^2], and of the spring, wind off
# [N*m/rad, N*m*s/rad].
INERTIA, INERTIA_UNCERTAINTY = 0.8, 0.002
SPRING = ab.Dynamics("PM", mass=INERTIA, stiffness=790.0, damping=0.2)
TRUTH = {"PM_theta": -150.0, "PM_q": -1.5}  # N*m/rad, N*m*s/rad
HELD = SPRING.stiffness * np.radians(3.0)  # N*m
BUFFETING = 0.5  # rms of the moment, 0-60 Hz [N*m]

generator = np.random.default_rng(SEED)

# %%
# Releases, wind off and wind on
# ------------------------------
# The model is held at three degrees for a second and let go. A hold of less than some
# periods of the spring is too short for the release to be found.


def release(*, wind):
    """One recording of the spring's reading."""
    flow = TRUTH if wind else dict.fromkeys(TRUTH, 0.0)
    model = replace(
        SPRING,
        stiffness=SPRING.stiffness - flow["PM_theta"],
        damping=SPRING.damping - flow["PM_q"],
    )
    rig = CableCut(
        dynamics=model,
        cable_force=HELD,
        release=RELEASE,
        applied=band_noise(generator, low=0.0, high=60.0, rms=BUFFETING, period=60.0)
        if wind
        else None,
        rate=RATE,
        sensors={"AF": Sensor(noise=0.02)},
    )
    test = rig.run(DURATION, generator).recording
    # The rig calls its component AF; and the spring reads its own stiffness times the
    # angle, without the flow's.
    reading = test.channel("AF")
    values = reading.values * SPRING.stiffness / model.stiffness
    return ab.Recording.from_columns(
        test.time,
        {"PM": replace(reading, name="PM", unit="N*m", values=values)},
        name="release",
    )


wind_off = release(wind=False)
spring = identify_decay(
    wind_off, component="PM", mass=(INERTIA, INERTIA_UNCERTAINTY)
).dynamics

# %%
# Moment of the flow on angle and rate
# ------------------------------------
# What comes after each release is a record of its own.


def derivatives(recording):
    """Time, moment of the flow, angle, and the regression of the one on the other."""
    later = np.flatnonzero(recording.time > RELEASE + 0.01)
    reading = replace(
        recording.channel("PM"), values=recording.channel("PM").values[later]
    )
    swinging = ab.Recording.from_columns(
        recording.time[later], {"PM": reading}, name="wind on"
    )
    force = ab.estimate_force(swinging, spring, bandwidth=BANDWIDTH).only
    angle = reading.values / spring.stiffness
    motion = {"constant": 1.0, "PM_theta": angle, "PM_q": np.gradient(angle, 1 / RATE)}
    return swinging.time, force, angle, regress(force, motion, span=INNER)


runs = [derivatives(release(wind=True)) for _ in range(RELEASES)]
fits = [fit for *_, fit in runs]

# %%
# Buffeting is another in every release, so its part falls with their number. The
# spring's dynamics and the scale of the angle are the same in all of them.

values = np.mean([fit.values for fit in fits], axis=0)
scatter = np.mean([np.diag(fit.scatter) for fit in fits], axis=0) / RELEASES
common = np.mean([np.diag(fit.measured) for fit in fits], axis=0)
scale = np.sqrt(spring.covariance[1, 1]) / spring.stiffness
u = np.sqrt(scatter + common + (scale * values) ** 2)

results = {
    name: (float(values[place]), float(u[place]))
    for place, name in enumerate(fits[0].names)
    if name in TRUTH
}
print("             truth      found        u   one release        u")
for name, row in results.items():
    print(
        "{:9s} {:9.3f} {:10.3f} {:8.3f} {:13.3f} {:8.3f}".format(
            name, TRUTH[name], *row, *fits[0].of(name)
        )
    )

# %%
# The first of the four releases. All of them together give the static derivative to 1 %
# and the damping to 3 %.

time, force, angle, fit = runs[0]
_, (top, bottom) = plt.subplots(
    2, 1, sharex=True, figsize=(7, 4.6), layout="constrained"
)
still = np.degrees(wind_off.channel("PM").values / spring.stiffness)
top.plot(wind_off.time, still, color="0.7", lw=1, label="wind off")
top.plot(time, np.degrees(angle), color="C0", lw=1, label="wind on")
top.set(ylabel="pitch [deg]", xlim=(RELEASE - 0.2, DURATION), ylim=(-3.5, 4.7))
top.legend(ncols=2, loc="upper right")
fitted = force.values[INNER] - fit.residual
bottom.plot(
    time[INNER],
    force.values[INNER],
    color="C0",
    lw=1,
    label="moment of the flow, recovered",
)
bottom.plot(time[INNER], fitted, "--", color="C3", lw=1, label="derivatives x motion")
bottom.set(xlabel="time [s]", ylabel="PM [N m]", ylim=(-8, 10))
bottom.legend(ncols=2, loc="upper right")
plt.show()

# %%
# What is claimed
# ---------------
# Both derivatives are within six standard uncertainties of the truth, which are judged
# from what buffeting left. Their signs are those of a model that is stable and damped.

for name, (value, spread) in results.items():
    assert abs(value - TRUTH[name]) < 6 * spread, name
    assert value < 0, name
