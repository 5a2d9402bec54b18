"""Mean loads of a test that vibrates: buffeting, a sting that shakes, a balance that rings, and a short record.

A mean over a few periods of ringing keeps a part of it: readings that swing by hundreds of newtons at 60 Hz leave
newtons in the mean of a quarter of a second. The force applied does not ring, so its mean over the same record is
known to the noise of the sensors. Gravity and the sting's motion are off it, too.

    python examples/mean_loads.py --figure mean_loads.png
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from aerobalance.estimation.force import estimate_force
from aerobalance.recording.components import COMPONENTS, si_unit
from aerobalance.simulation import Band, SixComponentRig, broadband, random_balance, random_motion, together
from aerobalance.uncertainty.regression import regress

RATE, DURATION = 3000.0, 0.3  # Hz, s
INNER = slice(75, -75)  # the mean of 0.25 s; where the record breaks off, the force is less sure
PITCH = np.radians(6.0)
MEAN = np.array([0.30, 0.20, 0.05, -0.05, 0.02, 0.10])  # loads, over half range, in the order of COMPONENTS
BUFFETING = 0.05  # rms over half range, 0-200 Hz: through the lower modes
SHAKING = np.array([1.0, 0.5, 1.0, 0.5, 0.5, 0.5])  # rms of the sting's accelerations, 5-60 Hz [m/s^2, rad/s^2]


def simulated(balance, generator):
    """Some tenths of a second, out of a test that has been going on."""
    buffeting = broadband(generator, Band(0, 200), rms=BUFFETING * balance.half_range, period=4 * DURATION)
    rig = SixComponentRig(
        balance,
        applied=together(buffeting, lambda time: np.tile(MEAN * balance.half_range, (time.size, 1))),
        base=random_motion(generator, Band(5, 60), rms=SHAKING, period=4 * DURATION),
        pitch=lambda time: np.full(time.size, PITCH),
        output="loads",
        rate=RATE,
    )
    return rig.run(DURATION, generator)


def main(seed=1, *, figure=None):
    generator = np.random.default_rng(seed)
    balance = random_balance(generator)
    test = simulated(balance, generator)

    # hum="keep": the buffeting of this test has power at 50 and 60 Hz, and no hum
    forces = estimate_force(test.recording, replace(balance.dynamics, mass=balance.mass), hum="keep")
    means = {name: regress(force, {"mean": 1.0}, span=INNER) for name, force in forces.items()}

    weight = balance.mass.weight(PITCH)[0]
    results = {}
    print("       mean applied    recovered        u   readings less weight")
    for place, name in enumerate(COMPONENTS):
        value, u = float(means[name].values[0]), float(means[name].measured_uncertainty[0])
        raw = float(np.mean(test.recording.channel(name).values[INNER]) - weight[place])
        truth = float(np.mean(test.applied[INNER, place]))
        results[name] = (value, u, truth, raw)
        print(f"{name}  {truth:13.3f} {value:12.3f} {u:8.3f} {raw:12.3f}  {si_unit(name)}")
    if figure:
        draw(figure, test, forces, results, balance.half_range)
    return results


def draw(path, test, forces, results, half_range):
    picture = Figure(figsize=(8, 3.8), layout="constrained")
    left, right = picture.subplots(1, 2, width_ratios=(3, 2))
    name, shown = "NF", slice(75, 450)
    time, truth = test.recording.time[shown], test.applied[shown, COMPONENTS.index(name)]
    left.plot(time, test.recording.channel(name).values[shown], color="C1", lw=0.8, label="reading")
    left.plot(time, truth, color="0.75", lw=3.5, label="applied, truth")
    left.plot(time, forces[name].values[shown], color="C0", lw=1, label="applied, recovered")
    left.set(xlabel="time [s]", ylabel="NF [N]")
    left.legend(fontsize="small", loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)

    value, u, truth, raw = 100 * np.array(list(results.values())).T / half_range
    right.semilogy(COMPONENTS, np.abs(raw - truth), "x", color="C1", label="readings less weight")
    right.semilogy(COMPONENTS, np.abs(value - truth), "o", color="C0", label="recovered")
    right.semilogy(COMPONENTS, 2 * u, "_", ms=14, color="k", label="95 % of the recovered")
    right.set(ylabel="error of the mean [% of half range]", ylim=(1e-5, 10))
    right.legend(fontsize="small", loc="upper right")
    picture.savefig(path, dpi=80, metadata={"Software": None}, pil_kwargs={"optimize": True})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figure", type=Path, help="PNG file to draw to")
    main(figure=parser.parse_args().figure)
