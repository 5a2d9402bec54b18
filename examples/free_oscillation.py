"""Static and damping derivative from free oscillations on a soft pitch spring, in a wind that buffets.

The spring of a free-oscillation rig is a balance of one component: it is calibrated, reads PM, and rings at 5 Hz. A
release wind off gives its dynamics. Wind on, Eq. (17) gives the moment of the flow at every instant of the ring-down,
and it goes with angle and rate of the model,

    PM = C0 + PM_theta theta + PM_q theta',        theta = reading / stiffness

Buffeting shakes the model as it rings down. The regression tells it apart, and says what it does to the derivatives.

    python examples/free_oscillation.py --figure free_oscillation.png
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.force import estimate_force
from aerobalance.identification.free_decay.fit import identify_decay
from aerobalance.recording.recording import Recording
from aerobalance.simulation import CableCut, Sensor, band_noise
from aerobalance.uncertainty.regression import regress

RATE, DURATION, RELEASE, RELEASES = 1000.0, 3.5, 1.0, 4  # Hz, s, s, and how many wind on
BANDWIDTH, INNER = 40.0, slice(150, -150)  # Hz; a band-limited force is less sure where the record breaks off
INERTIA, INERTIA_UNCERTAINTY = 0.8, 0.002  # of model and live end about the spring's axis [kg*m^2]
SPRING = Dynamics("PM", mass=INERTIA, stiffness=790.0, damping=0.2)  # N*m/rad, N*m*s/rad: wind off
TRUTH = {"PM_theta": -150.0, "PM_q": -1.5}  # N*m/rad, N*m*s/rad
HELD = SPRING.stiffness * np.radians(3.0)  # N*m
BUFFETING = 0.5  # rms of the moment, 0-60 Hz [N*m]


def release(generator, *, wind):
    """One recording of the spring's reading, held for a second and let go."""
    flow = TRUTH if wind else dict.fromkeys(TRUTH, 0.0)
    model = replace(SPRING, stiffness=SPRING.stiffness - flow["PM_theta"], damping=SPRING.damping - flow["PM_q"])
    rig = CableCut(
        dynamics=model,
        cable_force=HELD,
        release=RELEASE,
        applied=band_noise(generator, low=0.0, high=60.0, rms=BUFFETING, period=60.0) if wind else None,
        rate=RATE,
        sensors={"AF": Sensor(noise=0.02)},
    )
    test = rig.run(DURATION, generator).recording
    # The rig calls its component AF; and the spring reads its own stiffness times the angle, without the flow's.
    reading = test.channel("AF")
    values = reading.values * SPRING.stiffness / model.stiffness
    return Recording.from_columns(
        test.time, {"PM": replace(reading, name="PM", unit="N*m", values=values)}, name="release"
    )


def derivatives(recording, spring):
    """Moment of the flow on angle and rate, from the part of a recording after the release."""
    later = np.flatnonzero(recording.time > RELEASE + 0.01)
    reading = replace(recording.channel("PM"), values=recording.channel("PM").values[later])
    swinging = Recording.from_columns(recording.time[later], {"PM": reading}, name="wind on")
    force = estimate_force(swinging, spring, bandwidth=BANDWIDTH).only
    angle = reading.values / spring.stiffness
    motion = {"constant": 1.0, "PM_theta": angle, "PM_q": np.gradient(angle, 1 / RATE)}
    return swinging.time, force, angle, regress(force, motion, span=INNER)


def main(seed=1, *, figure=None):
    generator = np.random.default_rng(seed)
    wind_off = release(generator, wind=False)
    spring = identify_decay(wind_off, component="PM", mass=(INERTIA, INERTIA_UNCERTAINTY)).dynamics

    runs = [derivatives(release(generator, wind=True), spring) for _ in range(RELEASES)]
    fits = [fit for *_, fit in runs]
    values = np.mean([fit.values for fit in fits], axis=0)
    # Buffeting is another in every release; the spring's dynamics and the angle's scale are the same in all of them.
    scatter = np.mean([np.diag(fit.scatter) for fit in fits], axis=0) / RELEASES
    common = np.mean([np.diag(fit.measured) for fit in fits], axis=0)
    scale = np.sqrt(spring.covariance[1, 1]) / spring.stiffness
    u = np.sqrt(scatter + common + (scale * values) ** 2)

    results = {}
    print("             truth      found        u   one release        u")
    for name, truth in TRUTH.items():
        place, single = fits[0].names.index(name), fits[0].of(name)
        results[name] = (float(values[place]), float(u[place]), truth, single[0])
        print(f"{name:9s} {truth:9.3f} {values[place]:10.3f} {u[place]:8.3f} {single[0]:13.3f} {single[1]:8.3f}")
    if figure:
        draw(figure, wind_off, runs[0])
    return results


def draw(path, wind_off, run):
    time, force, angle, fit = run
    picture = Figure(figsize=(8, 4.6), layout="constrained")
    top, bottom = picture.subplots(2, 1, sharex=True)
    still = np.degrees(wind_off.channel("PM").values / SPRING.stiffness)
    top.plot(wind_off.time, still, color="0.7", lw=1, label="wind off")
    top.plot(time, np.degrees(angle), color="C0", lw=1, label="wind on")
    top.set(ylabel="pitch [deg]", xlim=(RELEASE - 0.2, DURATION), ylim=(-3.5, 4.7))
    top.legend(ncols=2, loc="upper right")
    fitted = force.values[INNER] - fit.residual
    bottom.plot(time[INNER], force.values[INNER], color="C0", lw=1, label="moment of the flow, recovered")
    bottom.plot(time[INNER], fitted, "--", color="C3", lw=1, label="derivatives x motion")
    bottom.set(xlabel="time [s]", ylabel="PM [N m]", ylim=(-8, 10))
    bottom.legend(ncols=2, loc="upper right")
    picture.savefig(path, dpi=80, metadata={"Software": None}, pil_kwargs={"optimize": True})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figure", type=Path, help="PNG file to draw to")
    main(figure=parser.parse_args().figure)
