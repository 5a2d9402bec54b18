"""What a test will reach, before it is run: the plan, held against a record that is made afterwards.

A buffet test on one component: the force to be expected, the noise of the amplifier and the dynamics of balance and
model are known. The plan says how large the uncertainty will be at every bandwidth, below, at and above the natural
frequency, and what limits it. Records of such forces then show that the plan is kept, and what a customary low-pass
filter makes of the same readings.

    python examples/plan_a_test.py --figure plan_a_test.png
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy import signal

import aerobalance as ab
from aerobalance.simulation import CableCut, Sensor, band_noise

RATE, DURATION = 2000.0, 4.0  # Hz, s
NOISE, EXPECTED = 1.5, 120.0  # N per reading; rms of the force [N]
MASS, NATURAL, RATIO = 60.0, 2 * np.pi * 80, 0.01  # kg, rad/s, damping ratio
BALANCE = ab.Dynamics("AF", mass=MASS, stiffness=MASS * NATURAL**2, damping=2 * RATIO * MASS * NATURAL)
BANDWIDTHS = (30.0, 60.0, 90.0, 120.0, 160.0)  # Hz
ENDS = slice(200, -200)  # a force is less sure where the record begins and ends


def record(generator, bandwidth):
    """A record of a force that is spread evenly up to a bandwidth, and the truth."""
    buffeting = band_noise(generator, low=0.0, high=bandwidth, rms=EXPECTED, period=60.0)
    rig = CableCut(
        dynamics=BALANCE, cable_force=0.0, applied=buffeting, rate=RATE, sensors={"AF": Sensor(noise=NOISE)}
    )
    return rig.run(DURATION, generator)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values[ENDS]))))


def main(seed=1, *, figure=None):
    generator = np.random.default_rng(seed)
    plan = ab.plan(BALANCE, rate=RATE, noise=NOISE, force=EXPECTED, bandwidths=BANDWIDTHS)["AF"]
    lowest = signal.butter(4, BALANCE.natural_frequency / 3, output="sos", fs=RATE)

    results = {}
    print("bandwidth     planned u    stated u   rms error    low pass")
    for row in plan.table:
        test = record(generator, row.bandwidth)
        force = ab.estimate_force(test.recording, BALANCE).only
        low_pass = signal.sosfiltfilt(lowest, test.recording.channel("AF").values)
        results[row.bandwidth] = (
            row.total,
            rms(force.uncertainty),
            rms(force.values - test.applied),
            rms(low_pass - test.applied),
        )
        print(f"{row.bandwidth:6.0f} Hz " + " ".join(f"{value:11.2f}" for value in results[row.bandwidth]) + "  N")
    print(plan.advice)
    if figure:
        draw(figure, results)
    return results


def draw(path, results):
    bandwidth = np.array(list(results))
    planned, stated, error, low_pass = np.array(list(results.values())).T
    picture = Figure(figsize=(8, 4), layout="constrained")
    axes = picture.subplots()
    axes.semilogy(bandwidth, low_pass, "^-", color="C1", lw=1, label="error of a low pass")
    axes.semilogy(bandwidth, planned, color="C0", lw=1.5, label="planned uncertainty")
    axes.semilogy(bandwidth, stated, "s", color="C0", mfc="none", label="stated for the record")
    axes.semilogy(bandwidth, error, "o", color="C3", ms=4, label="error of the force recovered")
    axes.axvline(BALANCE.natural_frequency, color="0.6", lw=1, ls="--")
    axes.annotate("natural frequency", (NATURAL / (2 * np.pi), 12), (4, 0), textcoords="offset points", color="0.4")
    axes.set(xlabel="bandwidth of the force [Hz]", ylabel="AF [N]")
    axes.legend(loc="center right")
    picture.savefig(path, dpi=80, metadata={"Software": None}, pil_kwargs={"optimize": True})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figure", type=Path, help="PNG file to draw to")
    main(figure=parser.parse_args().figure)
