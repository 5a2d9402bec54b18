"""Results of the commands on files of fixed content, as they were: no change may move them by more than rounding.

``python tests/golden/test_golden.py`` writes `pinned.json` anew; a commit that does so says in its message what
changed and why.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import laboratory

from aerobalance.app.cli import main
from aerobalance.estimation.live.live_force import LiveForce
from aerobalance.estimation.live.platform import LiveChannel
from aerobalance.estimation.live.settings import LiveSettings
from aerobalance.io import read
from aerobalance.io.dynamics_file import read_coupled, read_dynamics

PINNED = Path(__file__).with_name("pinned.json")
ROWS = 8
"""Samples of a record that are pinned, besides the root mean squares of all."""
MOST = 40
"""Numbers of an account that are pinned: evenly taken, where it has more."""
ROUNDING = 1e-6
"""Change over the rms of its kind that is rounding: fits end at 1e-8 to 1e-12, and other processors sum otherwise."""

UNSEEN = 1e-4
"""Change over its uncertainty by which nobody's result is another: of a small number that a fit ends at."""

NO_UNCERTAINTY = 1e-9
"""Uncertainty over its value that is the rounding of none."""

AXIAL = "--dynamics axial.json"
GAUGES = "--balance balance.json --zero zero.csv"
CUTS = " ".join(f"cut_{number}.csv" for number in range(1, 7))
STILL = " ".join(f"still_{number}.csv" for number in range(1, 10))
COMMANDS = {
    "force_gusts": f"force gusts.csv {AXIAL} -o out.h5",
    "force_by_the_paper": f"force gusts.csv {AXIAL} --method paper --bandwidth 200 -o out.h5",
    "force_gaps": f"force gaps.csv {AXIAL} -o out.h5",
    "force_hum": f"force hum.csv {AXIAL} -o out.h5",
    "force_shaken": f"force shaken.csv {AXIAL} --gravity 9.81 --u-gravity 0.001 -o out.h5",
    "force_noise_record": f"force gusts.csv {AXIAL} --noise-record calm.csv -o out.h5",
    "force_monte_carlo": f"force gusts.csv {AXIAL} --monte-carlo 12 --seed 3 -o out.h5",
    "identify_decay": f"identify decay cut.csv --mass {laboratory.MASS} -o out.json",
    "identify_rig": "identify rig rig.csv --mass 0.68 -o out.json",
    "identify_frf": "identify frf response.csv --component AF --mass 0.68 -o out.json",
    "identify_stiffness": "identify stiffness stiffness.csv --mass rigid_mass.toml --ratios 0.01 -o out.json",
    "weigh_points": "weigh points.csv --component AF -o out.json",
    "compare": f"compare gusts.csv {AXIAL}",
    "plan": f"plan {AXIAL} --noise 0.3 --rate 1600 --force 40 --bandwidth 150",
    "calibrate": "calibrate schedule.csv -o balance.json",
    "weigh_gauges": f"weigh {STILL} {GAUGES} -o mass.json",
    "loads_gauges": "loads gauges.csv --mass mass.json -o out.h5 " + GAUGES,
    "force_six": "force six.csv --dynamics six.json -o out.h5",
    "force_six_gauges": f"force gauges.csv --dynamics six.json {GAUGES} -o out.h5",
    "identify_six": f"identify decay {CUTS} --component all --mass mass.json -o out.json",
}


NOT_PINNED = {
    "provenance",
    "outputs",
    "replaced",
    "warnings",
    "seconds",
    "spectrum",
    "covariance",
    "residuals",
    "p",
    "absorbed",
}
"""Words, files and times; and numbers that are nothing but rounding in places."""


def flat(value: object, path: str = "") -> Iterator[tuple[str, float]]:
    """Numbers of an account by their places."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if key not in NOT_PINNED:
                yield from flat(inner, f"{path}/{key}")
    elif isinstance(value, list):
        for place, inner in enumerate(value):
            yield from flat(inner, f"{path}/{place}")
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield path, float(value)


def evenly(count: int, most: int) -> list[int]:
    return sorted({round(place) for place in np.linspace(0, count - 1, min(count, most))})


def least_changes(numbers: dict[str, float]) -> Iterator[tuple[str, float]]:
    """Changes that are none, by place: of a value beside its uncertainty, and of an uncertainty beside its value."""
    for place in numbers:
        stem, _, last = place.rpartition("/")
        if last == "value" and f"{stem}/u" in numbers:
            yield place, UNSEEN * abs(numbers[f"{stem}/u"])
        if last.startswith("u_") and f"{stem}/{last[2:]}" in numbers:
            yield place, NO_UNCERTAINTY * abs(numbers[f"{stem}/{last[2:]}"])


def result(line: str) -> dict:
    """What is pinned of one command, run in the current folder."""
    said, told = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(told):
        code = main([*line.split(), "--json", *(["--replace"] if " -o " in line else [])])
    assert code == 0, (line, told.getvalue())
    account = json.loads(said.getvalue())
    numbers = list(flat(account))
    found = {
        "numbers": {numbers[i][0]: numbers[i][1] for i in evenly(len(numbers), MOST)},
        "least": dict(least_changes(dict(numbers))),
        "warnings": len(account["warnings"]),
    }
    if line.endswith("out.h5") or " out.h5 " in line:
        recording = read("out.h5")
        found["channels"] = {channel.name: channel_of(channel.values) for channel in recording}
    return found


def every(folder: Path) -> dict:
    """Results of all commands: some take what others wrote."""
    laboratory.axial(folder)
    laboratory.six(folder)
    with contextlib.chdir(folder):
        found = {name: result(line) for name, line in COMMANDS.items()}
        return {**found, "live_axial": live_axial(), "live_six": live_six()}


def channel_of(values: np.ndarray) -> dict:
    return {
        "rms": float(np.sqrt(np.nanmean(values**2))),
        "values": [float(values[i]) for i in evenly(values.size, ROWS)],
    }


def live_axial() -> dict:
    """The live force of a shaken ground end, in chunks, learned on the way."""
    record = read("shaken.csv")
    live = LiveForce(
        read_dynamics("axial.json")["AF"],
        rate=laboratory.RATE,
        channels=["AF", LiveChannel("ground_acceleration", noise=2e-3), "pitch"],
        settings=LiveSettings(first_learning=1.0),
    )
    names = ("AF", "ground_acceleration", "pitch")
    columns = np.column_stack([record.channel(name).values for name in names])
    parts = [*(live.push(block)["AF"] for block in np.array_split(columns, 37)), live.finish()["AF"]]
    return {
        "numbers": {},
        "least": {},
        "warnings": 0,
        "channels": {
            "force": channel_of(np.concatenate([part.force for part in parts])),
            "uncertainty": channel_of(np.concatenate([part.uncertainty for part in parts])),
        },
    }


def live_six() -> dict:
    """The live forces of six coupled components, in chunks."""
    record = read("six.csv")
    live = LiveForce(read_coupled("six.json"), rate=2000.0, settings=LiveSettings(first_learning=0.4))
    loads = np.column_stack([record.channel(name).values for name in laboratory.NAMES])
    parts = [live.push(chunk) for chunk in np.array_split(loads, 23)]
    parts.append(live.finish())
    channels = {}
    for name in laboratory.NAMES:
        channels[name] = channel_of(np.concatenate([part[name].force for part in parts if name in part]))
        channels[f"u_{name}"] = channel_of(np.concatenate([part[name].uncertainty for part in parts if name in part]))
    return {"numbers": {}, "least": {}, "warnings": 0, "channels": channels}


def close(found: float, pinned: float, scale: float = 0.0, least: float = 0.0) -> bool:
    if np.isnan(pinned):
        return bool(np.isnan(found))
    return abs(found - pinned) <= max(ROUNDING * max(abs(pinned), scale), least)


def differences(found: dict, pinned: dict) -> Iterator[tuple[str, object, object]]:
    """What differs between two results of one command: place, now, then."""
    if found["warnings"] != pinned["warnings"]:
        yield "number of warnings", found["warnings"], pinned["warnings"]
    if list(found["numbers"]) != list(pinned["numbers"]):
        yield "names of the numbers", list(found["numbers"]), list(pinned["numbers"])
        return
    for place, then in pinned["numbers"].items():
        if not close(found["numbers"][place], then, least=found["least"].get(place, 0.0)):
            yield place, found["numbers"][place], then
    now = found.get("channels", {})
    if list(now) != list(pinned.get("channels", {})):
        yield "channels", list(now), list(pinned.get("channels", {}))
        return
    for channel, part in pinned.get("channels", {}).items():
        if not close(now[channel]["rms"], part["rms"]):
            yield f"rms of {channel}", now[channel]["rms"], part["rms"]
        for value, then in zip(now[channel]["values"], part["values"], strict=True):
            if not close(value, then, part["rms"]):
                yield f"a sample of {channel}", value, then


def test_results_are_what_they_were(tmp_path: Path) -> None:
    pinned = json.loads(PINNED.read_text())
    found = every(tmp_path)
    assert list(found) == list(pinned)
    changed = {name: list(differences(found[name], pinned[name])) for name in pinned}
    assert not {name: rows for name, rows in changed.items() if rows}


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        found = every(Path(made))
    for one in found.values():
        del one["least"]
    text = json.dumps(found, indent=1)
    PINNED.write_text(text + "\n")
