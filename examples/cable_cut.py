"""A cable is cut: when it parted and what it carried, from the first milliseconds of a ringing balance.

The oldest dynamic test of a balance: a known weight pulls at the model, its cable is cut, the balance rings at 66 Hz.
One cut in still air gives the dynamics. The next, in a wind that buffets, is a measurement: of what the cable carried,
of the instant, and of the wind's force right from it. A low-pass filter below the natural frequency smears all three.

    python examples/cable_cut.py --figure cable_cut.png
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy import signal

import aerobalance as ab
from aerobalance.simulation import CableCut, Sensor, band_noise

RATE, DURATION, NOISE = 1600.0, 3.0, 2.0  # Hz, s, N per reading
MASS, MASS_UNCERTAINTY = 177.87, 0.05  # weighed [kg]
BALANCE = ab.Dynamics("AF", mass=MASS, stiffness=3.093e7, damping=828.21)
KNOWN, UNKNOWN = -1000.0, -640.0  # pull of the cable in the two cuts [N]
BUFFETING = 15.0  # rms of the wind's force, 0-100 Hz [N]
AFTER = 0.05  # what is compared: so long after the cut [s]


def cut(generator, pull, *, wind):
    """The instant of a cut, which lies between two samples, and its recording."""
    release = 1.0 + generator.uniform(0.0, 1.0) / RATE
    rig = CableCut(
        dynamics=BALANCE,
        cable_force=pull,
        release=release,
        applied=band_noise(generator, low=0.0, high=100.0, rms=BUFFETING, period=60.0) if wind else None,
        rate=RATE,
        sensors={"AF": Sensor(noise=NOISE)},
    )
    return release, rig.run(DURATION, generator)


def main(seed=1, *, figure=None):
    generator = np.random.default_rng(seed)
    _, first = cut(generator, KNOWN, wind=False)
    dynamics = ab.identify(first.recording, mass=(MASS, MASS_UNCERTAINTY), components=["AF"]).dynamics

    release, test = cut(generator, UNKNOWN, wind=True)
    force = ab.estimate_force(test.recording, dynamics).only
    (step,) = force.steps
    time, reading = test.recording.time, test.recording.channel("AF").values
    lowest = signal.butter(4, dynamics.natural_frequency / 3, output="sos", fs=RATE)
    low_pass = signal.sosfiltfilt(lowest, reading)

    near = (time > release) & (time < release + AFTER)
    results = {
        "cut at [s]": (time[0] + step.instant, step.instant_uncertainty, release),
        "change [N]": (step.height, step.height_uncertainty, -UNKNOWN),
    }
    print("                  truth        found           u")
    for name, (value, u, truth) in results.items():
        print(f"{name:12s} {truth:12.6f} {value:12.6f} {u:11.6f}")
    print(f"largest error within {1e3 * AFTER:.0f} ms of the cut [N]")
    for name, values in (("force", force.values), ("low pass", low_pass), ("reading", reading)):
        results[name] = float(np.max(np.abs(values - test.applied)[near]))
        print(f"{name:12s} {results[name]:12.1f}")
    if figure:
        draw(figure, test, force, low_pass, release)
    return results


def draw(path, test, force, low_pass, release):
    time = 1e3 * (test.recording.time - release)
    picture = Figure(figsize=(8, 4.6), layout="constrained")
    top, bottom = picture.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    top.plot(time, test.recording.channel("AF").values, color="0.7", lw=1, label="reading")
    top.plot(time, low_pass, color="C1", lw=1, label="low pass")
    top.plot(time, force.values, color="C0", lw=1.2, label="force recovered")
    top.set(ylabel="AF [N]", xlim=(-40, 100), ylim=(-800, 1400))
    top.legend(loc="upper right", ncols=3)
    error = force.values - test.applied
    bottom.fill_between(time, -2 * force.uncertainty, 2 * force.uncertainty, color="C0", alpha=0.25, lw=0, label="2 u")
    bottom.plot(time, error, color="C0", lw=1, label="error of the force recovered")
    bottom.set(xlabel="time since the cut [ms]", ylabel="error [N]", ylim=(-5, 5))
    bottom.legend(ncols=2, loc="upper right")
    picture.savefig(path, dpi=80, metadata={"Software": None}, pil_kwargs={"optimize": True})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figure", type=Path, help="PNG file to draw to")
    main(figure=parser.parse_args().figure)
