"""Drag in a tunnel that runs for 10 ms: the mean on the plateau, and its uncertainty.

The flow starts within half a millisecond and holds for ten, while the balance has time for three swings at 320 Hz and
the tunnel recoils. A low-pass filter that removes the swings also smears start and stop into the plateau; the mean of
the raw reading depends on where in a swing it begins.

    python examples/short_duration.py --figure short_duration.png
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.force import estimate_force
from aerobalance.simulation import CableCut, Sensor, band_noise
from aerobalance.uncertainty.regression import regress
from aerobalance.validation.baselines import BaselineSettings, low_pass, raw_reading

RATE, DURATION = 25_000.0, 0.05  # Hz, s
BALANCE = Dynamics("AF", mass=4.0, stiffness=4.0 * (2 * np.pi * 320) ** 2, damping=0.005 * 2 * 4.0 * 2 * np.pi * 320)
NOISE, ACCELERATION_NOISE = 0.5, 0.05  # N, m/s^2 per reading
START, RISE, HOLD, FALL = 0.0152, 0.5e-3, 10e-3, 4e-3  # s
PLATEAU, UNSTEADY = 400.0, 4.0  # N, and rms of the flow's unsteadiness to 1 kHz [N]
USED = (START + RISE + 0.2e-3, START + RISE + HOLD - 0.2e-3)  # s: the plateau without its edges


def drag_of(generator):
    """Drag over time: a fast start, a plateau, and a slow end, with a little unsteadiness all along."""
    unsteady = band_noise(generator, low=0.0, high=1000.0, rms=UNSTEADY, period=1.0)

    def drag(time):
        rise = np.clip((time - START) / RISE, 0, 1)
        fall = np.clip((time - START - RISE - HOLD) / FALL, 0, 1)
        level = (3 * rise**2 - 2 * rise**3) * (1 - 3 * fall**2 + 2 * fall**3)
        return level * (PLATEAU + unsteady(time))

    return drag


def main(seed=1, *, figure=None):
    generator = np.random.default_rng(seed)
    rig = CableCut(
        dynamics=BALANCE,
        cable_force=0.0,
        applied=drag_of(generator),
        ground_acceleration=band_noise(generator, low=20.0, high=120.0, rms=3.0, period=1.0),
        rate=RATE,
        sensors={"AF": Sensor(noise=NOISE), "ground_acceleration": Sensor(noise=ACCELERATION_NOISE)},
    )
    test = rig.run(DURATION, generator)
    time = test.recording.time
    first, stop = np.searchsorted(time, USED)
    window = slice(int(first), int(stop))

    force = estimate_force(test.recording, BALANCE, hum="keep").only  # no mains in a record of 50 ms
    mean = regress(force, {"mean": 1.0}, span=window)
    rivals = {way.__name__: way(test.recording, BALANCE, BaselineSettings()).values for way in (raw_reading, low_pass)}

    truth = float(test.applied[window].mean())
    value, u = float(mean.values[0]), float(mean.measured_uncertainty[0])
    results = {"mean": (value, u, truth)} | {name: float(given[window].mean()) for name, given in rivals.items()}
    print(f"mean drag on the plateau     truth     {truth:9.2f} N")
    print(f"                             recovered {value:9.2f} N, u = {u:.2f} N")
    for name, label in (("raw_reading", "reading"), ("low_pass", "low-pass")):
        print(f"                             {label:9s} {results[name]:9.2f} N")
    if figure:
        draw(figure, test, force, rivals)
    return results


def draw(path, test, force, rivals):
    picture = Figure(figsize=(8, 4), layout="constrained")
    panel = picture.subplots()
    time = 1e3 * test.recording.time
    panel.axvspan(1e3 * USED[0], 1e3 * USED[1], color="0.93", label="averaged")
    panel.plot(time, rivals["raw_reading"], color="C1", lw=0.8, label="reading")
    panel.plot(time, rivals["low_pass"], "--", color="C2", lw=1.2, label="low-pass at 107 Hz")
    panel.plot(time, test.applied, color="0.7", lw=3.5, label="drag, truth")
    panel.plot(time, force.values, color="C0", lw=1, label="drag, recovered")
    panel.set(xlabel="time [ms]", ylabel="drag [N]", xlim=(10, 40))
    panel.legend(loc="upper right")
    picture.savefig(path, dpi=80, metadata={"Software": None}, pil_kwargs={"optimize": True})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figure", type=Path, help="PNG file to draw to")
    main(figure=parser.parse_args().figure)
