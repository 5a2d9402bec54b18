"""A parachute opens: the peak of the opening shock, and its uncertainty.

The canopy fills within some hundredths of a second, its drag shoots over and then fluctuates. A balance that rings at
45 Hz adds its own overshoot to the canopy's: the largest reading is no load that the parachute ever had.

    python examples/parachute.py --figure parachute.png
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.force import estimate_force
from aerobalance.simulation import CableCut, Sensor, band_noise
from aerobalance.uncertainty.budget import scalars

RATE, DURATION = 2000.0, 1.2  # Hz, s
BALANCE = Dynamics("AF", mass=20.0, stiffness=20.0 * (2 * np.pi * 45) ** 2, damping=0.01 * 2 * 20.0 * 2 * np.pi * 45)
NOISE, BANDWIDTH = 1.0, 150.0  # N per reading, Hz
OPENING, FILLING = 0.3, 0.03  # s
STEADY, OVERSHOOT, SETTLING = 1200.0, 1.8, 0.06  # N, over the steady drag, s


def drag_of(generator):
    """Drag over time: filling, overshoot, breathing of the canopy at 9 Hz, and turbulence."""
    turbulence = band_noise(generator, low=0.0, high=120.0, rms=40.0, period=20.0)

    def drag(time):
        since = np.maximum(time - OPENING, 0.0)
        progress = np.clip(since / FILLING, 0, 1)
        filled = progress**3 * (10 - 15 * progress + 6 * progress**2)
        shock = OVERSHOOT * np.exp(-since / SETTLING)
        breathing = 0.06 * np.sin(2 * np.pi * 9 * since)
        return filled * (STEADY * (1 + shock + breathing) + turbulence(time))

    return drag


def main(seed=1, *, figure=None):
    generator = np.random.default_rng(seed)
    rig = CableCut(
        dynamics=BALANCE,
        cable_force=0.0,
        applied=drag_of(generator),
        rate=RATE,
        sensors={"AF": Sensor(noise=NOISE)},
    )
    test = rig.run(DURATION, generator)

    # One opening is too little to learn a spectrum from, so the band is given: the canopy does little above it.
    force = estimate_force(test.recording, BALANCE, bandwidth=BANDWIDTH).only
    summary = {scalar.name: scalar for scalar in scalars(force)}
    reading = test.recording.channel("AF").values
    steady = test.recording.time > OPENING + 0.4

    found, truth = summary["largest"], float(test.applied.max())
    results = {
        "peak": (found.value, found.u, truth, float(reading.max())),
        "rms of the steady drag": (
            float(force.values[steady].std()),
            None,
            float(test.applied[steady].std()),
            float(reading[steady].std()),
        ),
    }
    print("                            truth    found       u   reading")
    for name, (value, u, exact, raw) in results.items():
        print(f"{name:24s} {exact:8.1f} {value:8.1f} {'' if u is None else f'{u:.1f}':>7s} {raw:9.1f}  N")
    if figure:
        draw(figure, test, force, found)
    return results


def draw(path, test, force, peak):
    picture = Figure(figsize=(8, 4.6), layout="constrained")
    whole, near = picture.subplots(1, 2, width_ratios=(2, 1))
    time, reading = test.recording.time, test.recording.channel("AF").values
    for panel in (whole, near):
        panel.plot(time, reading, color="C1", lw=0.8, label="reading")
        panel.plot(time, test.applied, color="0.75", lw=3.5, label="drag, truth")
        panel.plot(time, force.values, color="C0", lw=1, label="drag, recovered")
        panel.set_xlabel("time [s]")
    near.set_xlim(OPENING - 0.01, OPENING + 0.1)
    place = int(np.argmax(force.values))
    label = f"peak, {peak.value:.0f} ± {2 * peak.u:.0f} N (95 %)"
    near.errorbar(time[place], peak.value, 2 * peak.u, fmt="o", ms=4, color="k", capsize=3, label=label)
    whole.set_ylabel("drag [N]")
    near.legend(loc="lower right", fontsize="x-small")
    picture.savefig(path, dpi=80, metadata={"Software": None}, pil_kwargs={"optimize": True})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figure", type=Path, help="PNG file to draw to")
    main(figure=parser.parse_args().figure)
