"""Files that the examples of the README and of ``--help`` name: one test of one balance, from mV/V to the force.

The balance is that of the cable cut with six bridges that interact. A laboratory's own recorder wrote the text files:
foreign headers, semicolons and decimal commas, which the channel map explains.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from aerobalance.app.commands import calibration, identify, weighing
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.io import write_recording
from aerobalance.io.balfit_file import write_balfit_schedule
from aerobalance.io.safe_write import replacing
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import COMPONENTS, STANDARD_GRAVITY
from aerobalance.recording.gravity import gravity_share
from aerobalance.recording.recording import Recording
from aerobalance.simulation import CableCut, Sensor, VibrationRig
from aerobalance.simulation.calibration_stand import CalibrationStand
from aerobalance.simulation.drives import Signal, Sweep, band_noise
from aerobalance.simulation.hammer import Blow, Hammer, Tapping
from aerobalance.simulation.published import CABLE_CUT, VIBRATION_RIG
from aerobalance.simulation.six_balance import CoupledBalance, random_balance

RANGE: Final = np.array([4000.0, 200.0, 2000.0, 150.0, 80.0, 2000.0])
"""Half of range of the components [N, N*m]."""

WEIGHT: Final = CABLE_CUT.mass * STANDARD_GRAVITY
"""Weight of the model [N]."""

NOISE: Final = 1e-4
"""Noise of a bridge over its output at half of range."""

ANGLES: Final = (-12.0, -8.0, -4.0, 0.0, 4.0, 8.0, 12.0)
"""Pitch at which the balance is weighed [deg]."""

MAP: Final = """\
# What the columns of the laboratory's recorder are.
[file]
time = "Zeit"

[channels.pitch]
column = "Winkel"
unit = "deg"
"""

STIFFNESS: Final = (9e6, 2.5e4, 8e6, 3e4, 6e3, 1.8e7)
"""Stiffness of the balance under a rigid model, by component [N/m, N*m]."""

RIGID_MASS: Final = """\
mass = {value = 20.0, u = 0.01}

[centre]
aft = {value = 0.04, u = 1e-4}
right = 0.0
up = {value = 0.01, u = 1e-4}

[inertia]
aa = {value = 0.3, u = 0.002}
rr = {value = 0.9, u = 0.002}
uu = {value = 0.8, u = 0.002}
"""

MODES: Final = """\
    -1
    55
balance with model
one mode, of the response functions of taps
NONE
NONE
NONE
         1         3         2         8         5         3
         2         6         0         1
 -4.17195E+00  4.17175E+02  1.00000E+00  0.00000E+00  0.00000E+00  0.00000E+00
         1
  1.00000E+00  0.00000E+00  0.00000E+00  0.00000E+00  0.00000E+00  0.00000E+00
    -1
"""
"""A pole at 66.4 Hz with a damping ratio of 1 %, and its shape, as a modal program writes them."""

SETUP: Final = """\
[source]
kind = "simulated"
rig = "cable_cut"
"""


@dataclass(frozen=True, slots=True)
class _Laboratory:
    """Where the files go, the balance, and the source of all randomness."""

    folder: Path
    balance: CoupledBalance
    generator: np.random.Generator

    def write(self, name: str, text: str) -> None:
        with replacing(self.folder / name) as beside:
            beside.write_text(text, encoding="utf-8")

    def bridges(self, name: str, time: Array, axial: Array, pitch: Array) -> None:
        """Write what the recorder makes of a balance load along AF and of the weight along NF."""
        loads = np.zeros((time.size, len(COMPONENTS)))
        loads[:, COMPONENTS.index("AF")] = axial
        loads[:, COMPONENTS.index("NF")] = WEIGHT * gravity_share("NF", pitch=pitch, roll=np.zeros(time.size))
        outputs = self.balance.outputs(loads)
        outputs += NOISE * self.balance.matrix.output_scale * self.generator.standard_normal(outputs.shape)
        lines = [";".join(["Zeit [s]", *(f"DMS {number} [mV/V]" for number in range(1, 7)), "Winkel [deg]"])]
        rows = np.column_stack([time, outputs, np.rad2deg(pitch)])
        lines += [";".join(f"{cell:.7g}" for cell in row).replace(".", ",") for row in rows]
        self.write(name, "\n".join(lines) + "\n")


def write_examples(folder: Path, generator: np.random.Generator) -> None:
    """Write the files that the examples name.

    Parameters
    ----------
    folder
        Folder that exists.
    generator
        Source of randomness.

    Raises
    ------
    ValueError
        A file cannot be written.
    """
    laboratory = _Laboratory(folder, _balance(generator), generator)
    columns = "".join(
        f'\n[channels.r{name}]\ncolumn = "DMS {number}"\nunit = "mV/V"\n' for number, name in enumerate(COMPONENTS, 1)
    )
    laboratory.write("map.toml", MAP + columns)
    laboratory.write("test.toml", SETUP)
    _calibrated(laboratory)
    _weighed(laboratory)
    _cut(laboratory)
    _run(laboratory)
    _polar(laboratory)
    _other_ways(laboratory)


def _balance(generator: np.random.Generator) -> CoupledBalance:
    """A balance with bridges that interact, of the range of the cable cut."""
    drawn = random_balance(generator)
    matrix = replace(drawn.matrix, load_scale=RANGE, calibrated=np.array([-RANGE, RANGE]))
    return replace(drawn, half_range=RANGE, matrix=matrix)


def _calibrated(laboratory: _Laboratory) -> None:
    """Two calibrations, the sensitivities of the older one 0.2 % lower, and the matrix of the newer."""
    new: BalanceMatrix = laboratory.balance.matrix
    old = replace(new, output_scale=new.output_scale * 0.998)
    for name, matrix in (("schedule_2022.csv", old), ("schedule.csv", new)):
        stand = CalibrationStand(matrix, noise=NOISE * float(matrix.output_scale.min()), repeats=2)
        schedule = stand.run(int(laboratory.generator.integers(1 << 31))).schedule
        write_balfit_schedule(laboratory.folder / name, schedule)
    calibration.calibrate(laboratory.folder / "schedule.csv", laboratory.folder / "balance.json")


def _weighed(laboratory: _Laboratory) -> None:
    """The balance at rest at several angles, as bridges and as points, and its zero, level with the model on."""
    time = np.arange(400) / CABLE_CUT.rate.value
    for number, angle in enumerate(np.deg2rad(ANGLES), 1):
        pitch = np.full(time.size, angle)
        laboratory.bridges(f"pitch_{number}.txt", time, WEIGHT * np.sin(pitch), pitch)
    laboratory.bridges("zero.txt", time, np.zeros(time.size), np.zeros(time.size))
    u = 0.05
    loads = WEIGHT * np.sin(np.deg2rad(ANGLES)) + u * laboratory.generator.standard_normal(len(ANGLES))
    rows = [f"{angle:g},{load:.4f},{u:g}" for angle, load in zip(ANGLES, loads, strict=True)]
    laboratory.write("points.csv", "\n".join(["pitch [deg],AF [N],u_AF [N]", *rows]) + "\n")
    weighing.weigh([laboratory.folder / "points.csv"], laboratory.folder / "mass.json")


def _cut(laboratory: _Laboratory) -> None:
    """A cable cut, as bridges and as balance loads."""
    found = CableCut(sensors={"AF": Sensor(noise=0.2)}).run(3.0, laboratory.generator)
    time = found.recording.time
    laboratory.bridges("cut.txt", time, found.load, np.zeros(time.size))
    write_recording(laboratory.folder / "cut.csv", found.recording)
    identify.identify_decay(
        laboratory.folder / "cut.csv",
        laboratory.folder / "dynamics.json",
        mass=str(laboratory.folder / "mass.json"),
    )


def _run(laboratory: _Laboratory) -> None:
    """A run at an angle, gusts and a step: as bridges, as balance loads, and the truth."""
    gusts = band_noise(laboratory.generator, low=1.0, high=150.0, rms=40.0, period=20.0)
    angle = np.deg2rad(4.0)
    rig = CableCut(
        cable_force=-200.0,
        release=1.5003,
        applied=lambda time: 300.0 + gusts(time),
        pitch=lambda time: np.full(time.shape, angle),
        sensors={"AF": Sensor(noise=0.2), "pitch": Sensor()},
    )
    found = rig.run(3.0, laboratory.generator)
    time = found.recording.time
    laboratory.bridges("run.txt", time, found.load, np.full(time.size, angle))
    write_recording(laboratory.folder / "run.csv", found.recording)
    _columns(laboratory.folder / "truth.csv", time, {"AF": found.applied})


def _polar(laboratory: _Laboratory) -> None:
    """Four runs of a test, two of them repeats, as balance loads."""
    folder = laboratory.folder / "runs"
    folder.mkdir(exist_ok=True)
    for number, degrees in enumerate((0.0, 4.0, 8.0, 4.0), 1):
        gusts = band_noise(laboratory.generator, low=1.0, high=150.0, rms=20.0, period=20.0)
        rig = CableCut(
            cable_force=0.0,
            applied=partial(_steady_with, gusts, 250.0 + 3.0 * degrees**2),
            pitch=partial(np.full_like, fill_value=np.deg2rad(degrees)),
            sensors={"AF": Sensor(noise=0.2), "pitch": Sensor()},
        )
        write_recording(folder / f"run_{number}.csv", rig.run(1.5, laboratory.generator).recording)


def _steady_with(gusts: Signal, mean: float, time: Array) -> Array:
    """A mean and gusts over time [N]."""
    return np.asarray(mean + gusts(time))


def _columns(path: Path, time: Array, loads: Mapping[str, Array]) -> None:
    channels = {name: Channel(name, values, "N") for name, values in loads.items()}
    write_recording(path, Recording.from_columns(time, channels, name=path.stem))


def _other_ways(laboratory: _Laboratory) -> None:
    """What the other ways to the dynamics take: a shaken rig, a published response, a stiffness with a rigid mass."""
    folder, generator = laboratory.folder, laboratory.generator
    shaken = VibrationRig().run(Sweep(30.0, 1000.0, 2.0), generator)
    write_recording(folder / "sweep.csv", shaken.recording)
    dynamics = VIBRATION_RIG.dynamics
    frequency = np.linspace(100.0, 1000.0, 19)
    response = dynamics.response(frequency)
    u_amplitude, u_phase = 0.002 * np.abs(response), np.full(frequency.size, 0.1)
    amplitude = np.abs(response) + u_amplitude * generator.standard_normal(frequency.size)
    phase = np.rad2deg(np.angle(response)) + u_phase * generator.standard_normal(frequency.size)
    rows = np.column_stack([frequency, amplitude, u_amplitude, phase, u_phase])
    head = "frequency [Hz],amplitude [1],u_amplitude [1],phase [deg],u_phase [deg]"
    laboratory.write(
        "response.csv", "\n".join([head, *(",".join(f"{cell:.6g}" for cell in row) for row in rows)]) + "\n"
    )
    _tapped(laboratory)
    lines = [",".join(["", *COMPONENTS])]
    for word, size in (("", 1.0), ("u ", 1e-3)):
        table = size * np.diag(STIFFNESS)
        lines += [
            ",".join([word + name, *(f"{cell:g}" for cell in row)])
            for name, row in zip(COMPONENTS, table, strict=True)
        ]
    laboratory.write("stiffness.csv", "\n".join(lines) + "\n")
    laboratory.write("rigid_mass.toml", RIGID_MASS)


def _tapped(laboratory: _Laboratory) -> None:
    """Five taps of an instrumented hammer, one of which bounced, and the mode that another program found of such."""
    (generator,) = laboratory.generator.spawn(1)  # what is drawn after this stays what it was
    blows = [Blow(0.4 + 1.2 * number, generator.uniform(500.0, 900.0), 0.004) for number in range(5)]
    tapping = Tapping(
        CoupledDynamics.of_components([CABLE_CUT.dynamics]),
        np.array([1.0]),
        (*blows, Blow(blows[3].instant + 0.025, 120.0, 0.004)),
        hammer=Hammer(noise=0.5),
        noise=np.array([0.2]),
        rate=CABLE_CUT.rate.value,
    )
    write_recording(laboratory.folder / "taps.csv", tapping.record(6.5, generator, name="taps"))
    laboratory.write("modes.uff", MODES)
