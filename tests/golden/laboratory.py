"""Files of a made-up laboratory, from closed forms alone, for results that are pinned.

Nothing here is taken from the package, so that moving or mending its rigs does not change what goes in. Loads are
those of linear balances: forces that are sums of sines have sums of sines for loads, and a release or a step has the
modes' decay. Noise comes from a generator of fixed seed.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NAMES = ("NF", "PM", "SF", "YM", "RM", "AF")
UNITS = ("N", "N*m", "N", "N*m", "N*m", "N")
G = 9.80665
RATE = 1600.0
MASS, STIFFNESS, DAMPING = 177.87, 3.093e7, 828.21
HALF_RANGE = np.array([2000.0, 150.0, 1000.0, 100.0, 60.0, 800.0])
SIX_MASS = 21.3
CENTRE = np.array([0.031, 0.002, 0.008])  # aft, right, up [m]
INERTIA = np.array([[0.11, 0.004, -0.006], [0.004, 0.62, 0.002], [-0.006, 0.002, 0.58]])  # aft, right, up [kg*m^2]
COVARIANCE_OF_MODES = (148.0, 121.0, 133.0, 176.0, 262.0, 214.0)  # natural frequencies [Hz]


class Sines:
    """A sum of sines: values, and what a linear system of one input makes of it."""

    def __init__(self, rng: np.random.Generator, low: float, high: float, count: int, rms: float) -> None:
        self.frequency = np.sort(rng.uniform(low, high, count))
        self.size = rms * np.sqrt(2 / count) * np.exp(2j * np.pi * rng.random(count))

    def __call__(self, time: Array) -> Array:
        return self.through(time, np.ones_like(self.frequency))

    def through(self, time: Array, response: NDArray) -> Array:
        """Values behind a response of shape (count,)."""
        turns = np.exp(2j * np.pi * np.outer(time, self.frequency))
        return np.asarray((turns @ (self.size * response)).real)


def table(path: Path, time: Array, columns: dict[str, Array]) -> Path:
    """Write a recording as text."""
    lines = [",".join(["time [s]", *columns])]
    rows = np.column_stack([time, *columns.values()])
    lines += [",".join("" if np.isnan(cell) else f"{cell:.10g}" for cell in row) for row in rows]
    path.write_text("\n".join(lines) + "\n")
    return path


def given(path: Path, payload: dict) -> Path:
    """Write an artefact as by hand."""
    path.write_text(json.dumps(payload, indent=1))
    return path


def value(number: float, u: float = 0.0, unit: str = "1") -> dict:
    return {"value": number, "u": u, "unit": unit}


# ----------------------------------------------------------------------------- one component


def axial_response(frequency: Array) -> NDArray:
    """Balance load over force."""
    s = 2j * np.pi * frequency
    return 1 / (1 + DAMPING / STIFFNESS * s + MASS / STIFFNESS * s**2)


def axial_step(time: Array, instant: float, size: float) -> Array:
    """Balance load after a step of the force."""
    w = np.sqrt(STIFFNESS / MASS)
    d = DAMPING / (2 * np.sqrt(STIFFNESS * MASS))
    wd, later = w * np.sqrt(1 - d**2), np.maximum(time - instant, 0.0)
    ring = np.exp(-d * w * later) * (np.cos(wd * later) + d * w / wd * np.sin(wd * later))
    return np.where(time >= instant, size * (1 - ring), 0.0)


def axial(folder: Path) -> None:
    """Records of one component, its dynamics, weighing points, and what identifies it."""
    rng = np.random.default_rng(20261122)
    given(
        folder / "axial.json",
        {
            "kind": "dynamics",
            "schema": 1,
            "components": {
                "AF": {
                    "mass": value(MASS, 0.03, "kg"),
                    "stiffness": value(STIFFNESS, 3e4, "N/m"),
                    "damping": value(DAMPING, 9.0, "N*s/m"),
                }
            },
        },
    )
    time = np.arange(int(2.5 * RATE)) / RATE
    gusts, noise = Sines(rng, 1.0, 150.0, 400, 40.0), 0.3 * rng.standard_normal(time.size)
    felt = gusts.through(time, axial_response(gusts.frequency)) + axial_step(time, 1.20013, 300.0)
    table(folder / "gusts.csv", time, {"AF [N]": felt + noise})
    missing = felt + noise
    missing[900:912] = np.nan
    missing[2500:2501] = np.nan
    table(folder / "gaps.csv", time, {"AF [N]": missing})
    hum = 3.0 * np.sin(2 * np.pi * 50.0 * time + 0.3) + 1.0 * np.sin(2 * np.pi * 150.0 * time + 1.1)
    table(folder / "hum.csv", time, {"AF [N]": felt + noise + hum})
    # a ground that shakes and pitches: AF carries (M g sin(pitch) - M x1'') through the same response
    shake, turn = Sines(rng, 3.0, 60.0, 60, 0.4), Sines(rng, 0.3, 8.0, 12, np.radians(0.3))
    pull = MASS * G * (np.radians(4.0) + turn.through(time, axial_response(turn.frequency)))  # sine of a small angle
    ground = felt + pull - MASS * shake.through(time, axial_response(shake.frequency))
    table(
        folder / "shaken.csv",
        time,
        {
            "AF [N]": ground + noise,
            "ground_acceleration [m/s^2]": shake(time) + 2e-3 * rng.standard_normal(time.size),
            "pitch [rad]": np.arcsin(np.radians(4.0) + turn(time)),
        },
    )
    calm = np.arange(4000) / RATE
    colored = np.convolve(rng.standard_normal(4100), 0.6 ** np.arange(100), mode="valid")[:4000]
    table(folder / "calm.csv", calm, {"AF [N]": 0.3 * colored})
    ring = np.arange(int(1.5 * RATE)) / RATE
    cut = axial_step(ring, 0.3003, 1020.0) - 1020.0
    table(folder / "cut.csv", ring, {"AF [N]": cut + 0.2 * rng.standard_normal(ring.size)})
    angles = np.radians([-12.0, -8.0, -4.0, 0.0, 4.0, 8.0, 12.0])
    points = MASS * G * np.sin(angles + 0.0005) + 3.0 + 0.1 * rng.standard_normal(angles.size)
    rows = [f"{np.degrees(angle):.6g},{load:.6g},0.1" for angle, load in zip(angles, points, strict=True)]
    (folder / "points.csv").write_text("\n".join(["pitch [deg],AF [N],u_AF [N]", *rows]) + "\n")
    _rig(folder, rng)


def _rig(folder: Path, rng: np.random.Generator) -> None:
    """A shaken ground end in broad noise, and a published response."""
    mass, stiffness, damping = 0.68, 4.2e4, 1.1
    time = np.arange(6000) / 1000.0
    shake = Sines(rng, 5.0, 120.0, 500, 2.0)
    s = 2j * np.pi * shake.frequency
    response = -mass / (1 + damping / stiffness * s + mass / stiffness * s**2)
    table(
        folder / "rig.csv",
        time,
        {
            "AF [N]": shake.through(time, response) + 2e-3 * rng.standard_normal(time.size),
            "ground_acceleration [m/s^2]": shake(time) + 1e-3 * rng.standard_normal(time.size),
        },
    )
    frequency = np.arange(10.0, 80.0, 5.0)
    s = 2j * np.pi * frequency
    transmitted = (1 + damping / stiffness * s) / (1 + damping / stiffness * s + mass / stiffness * s**2)
    rows = [
        f"{f:g},{abs(one) + 1e-3 * rng.standard_normal():.8g},1e-3,"
        f"{np.degrees(np.angle(one)) + 0.05 * rng.standard_normal():.8g},0.05"
        for f, one in zip(frequency, transmitted, strict=True)
    ]
    header = "frequency [Hz],amplitude [1],u_amplitude [1],phase [deg],u_phase [deg]"
    (folder / "response.csv").write_text("\n".join([header, *rows]) + "\n")


# ----------------------------------------------------------------------------- six components


def rigid_mass() -> Array:
    """Mass matrix of the rigid mass about the balance's centre, in the order of `NAMES`, shape (6, 6).

    Loads are NF up, PM nose up about the axis to the left, SF right, YM nose right, RM right side down, AF aft.
    """
    aft, right, up = np.eye(3)
    # velocity of the mass along aft, right, up by a unit rate of each coordinate; PM = u W_aft - a W_up and so on
    lever = CENTRE
    moments = {
        "PM": np.array([lever[2], 0.0, -lever[0]]),
        "YM": np.array([lever[1], -lever[0], 0.0]),
        "RM": np.array([0.0, lever[2], -lever[1]]),
    }
    turning = {"PM": right, "YM": -up, "RM": -aft}
    straight = {"NF": up, "SF": right, "AF": aft}
    found = np.zeros((6, 6))
    for i, row in enumerate(NAMES):
        for j, column in enumerate(NAMES):
            a, b = straight.get(row, moments.get(row)), straight.get(column, moments.get(column))
            found[i, j] = SIX_MASS * a @ b
            if row in turning and column in turning:
                found[i, j] += turning[row] @ INERTIA @ turning[column]
    return found


def six_matrices() -> tuple[Array, Array]:
    """A [s^2 ...] and D [s ...] of coupled components: F = f + D f' + A f''."""
    rng = np.random.default_rng(6)
    mass = rigid_mass()
    w = 2 * np.pi * np.array(COVARIANCE_OF_MODES)
    scale = np.sqrt(np.diag(mass))
    turn, _ = np.linalg.qr(np.eye(6) + 0.08 * rng.standard_normal((6, 6)))
    root = np.linalg.cholesky(mass)
    shapes = root @ turn
    stiffness = shapes @ np.diag(w**2) @ shapes.T
    damping = shapes @ np.diag(2 * 0.012 * w) @ shapes.T
    assert np.all(scale > 0)
    return mass @ np.linalg.inv(stiffness), damping @ np.linalg.inv(stiffness)


class SixBalance:
    """Six coupled components: balance loads after sums of sines and a release."""

    def __init__(self) -> None:
        self.A, self.D = six_matrices()
        nothing, one = np.zeros((6, 6)), np.eye(6)
        inverse = np.linalg.inv(self.A)
        self.poles, self.vectors = np.linalg.eig(np.block([[nothing, one], [-inverse, -inverse @ self.D]]))

    def felt(self, time: Array, gusts: list[Sines], coupling: Array) -> Array:
        """Loads after forces ``coupling @ gusts``, shape (n, 6)."""
        found = np.zeros((time.size, 6))
        for column, one in enumerate(gusts):
            s = 2j * np.pi * one.frequency
            system = np.eye(6) + s[:, None, None] * self.D + (s**2)[:, None, None] * self.A
            response = np.linalg.solve(system, np.broadcast_to(coupling[:, column, None], (s.size, 6, 1)))[:, :, 0]
            turns = np.exp(2j * np.pi * np.outer(time, one.frequency))
            found += (turns @ (one.size[:, None] * response)).real
        return found

    def released(self, time: Array, instant: float, load: Array) -> Array:
        """Loads after a static load is let go, shape (n, 6)."""
        start = np.linalg.solve(self.vectors, np.concatenate([load, np.zeros(6)]).astype(complex))
        later = np.maximum(time - instant, 0.0)
        ring = (np.exp(np.outer(later, self.poles)) * start) @ self.vectors[:6].T
        return np.where((time >= instant)[:, None], ring.real, load)


def six(folder: Path) -> None:
    """Records of six coupled components as loads and as gauge outputs, their dynamics, balance and weighing."""
    rng = np.random.default_rng(20261123)
    balance = SixBalance()
    loads = _own_noise(rng)
    given(
        folder / "six.json",
        {
            "kind": "coupled dynamics",
            "schema": 1,
            "components": list(NAMES),
            "inertia": {"matrix": balance.A.tolist(), "u": (1e-4 * np.abs(balance.A)).tolist()},
            "damping": {"matrix": balance.D.tolist(), "u": (1e-2 * np.abs(balance.D)).tolist()},
            "mass": {
                "mass": value(SIX_MASS, 0.002, "kg"),
                "centre": {
                    name: value(place, 1e-5, "m") for name, place in zip(("aft", "right", "up"), CENTRE, strict=True)
                },
                "inertia": {
                    name: value(float(INERTIA[place]), 1e-4, "kg*m^2")
                    for name, place in {
                        "aa": (0, 0),
                        "rr": (1, 1),
                        "uu": (2, 2),
                        "ar": (0, 1),
                        "au": (0, 2),
                        "ru": (1, 2),
                    }.items()
                },
            },
        },
    )
    stiffness = np.linalg.solve(balance.A, rigid_mass())
    rows = [",".join([name, *(f"{cell:.10g}" for cell in row)]) for name, row in zip(NAMES, stiffness, strict=True)]
    (folder / "stiffness.csv").write_text("\n".join([",".join(["", *NAMES]), *rows]) + "\n")
    places = "\n".join(f"{name} = {place}" for name, place in zip(("aft", "right", "up"), CENTRE, strict=True))
    turns = {"aa": (0, 0), "rr": (1, 1), "uu": (2, 2)}
    turning = "\n".join(f"{name} = {INERTIA[place]}" for name, place in turns.items())
    (folder / "rigid_mass.toml").write_text(
        f"mass = {{value = {SIX_MASS}, u = 0.01}}\n[centre]\n{places}\n[inertia]\n{turning}\n"
    )
    time = np.arange(int(1.2 * 2000)) / 2000.0
    gusts = [Sines(rng, 2.0, 200.0, 200, 0.04) for _ in NAMES]
    felt = balance.felt(time, gusts, np.diag(HALF_RANGE))
    table(folder / "six.csv", time, _columns(felt + loads(time.size)))
    for number in range(1, 7):
        load = 0.05 * HALF_RANGE * rng.standard_normal(6)
        load[number - 1] = 0.3 * HALF_RANGE[number - 1]
        ring = np.arange(int(0.8 * 2000)) / 2000.0
        table(folder / f"cut_{number}.csv", ring, _columns(balance.released(ring, 0.1502, load) + loads(ring.size)))
    _gauges(folder, rng, balance, time, felt)


def _own_noise(rng: np.random.Generator):
    return lambda count: 2e-4 * HALF_RANGE * rng.standard_normal((count, 6))


def _columns(loads: Array) -> dict[str, Array]:
    return {f"{name} [{unit}]": loads[:, i] for i, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True))}


class Bridges:
    """Bridges that interact and are curved: r = C x + sum of q_ij x_i x_j + p_i |x_i|, x the loads over half range."""

    def __init__(self) -> None:
        rng = np.random.default_rng(66)
        self.linear = np.diag(rng.uniform(0.8, 1.2, 6)) + 0.03 * rng.standard_normal((6, 6))
        self.squares = 0.004 * rng.standard_normal((6, 6, 6))
        self.both_ways = 0.006 * rng.standard_normal((6, 6))
        self.natural_zero = 0.03 * rng.standard_normal(6)

    def outputs(self, loads: Array) -> Array:
        """Gauge outputs of loads of shape (n, 6) [mV/V]."""
        x = loads / HALF_RANGE
        curved = np.einsum("kij,ni,nj->nk", self.squares, x, x)
        return np.asarray(x @ self.linear.T + curved + np.abs(x) @ self.both_ways.T + self.natural_zero)


def _weight(pitch: Array, roll: Array) -> Array:
    """Loads of the rigid mass at rest, shape (n, 6)."""
    pull = SIX_MASS * G * np.stack([np.sin(pitch), np.cos(pitch) * np.sin(roll), -np.cos(pitch) * np.cos(roll)])
    aft, right, up = pull
    a, y, u = CENTRE
    return np.stack([up, u * aft - a * up, right, -(a * right - y * aft), -(y * up - u * right), aft], axis=1)


def _gauges(folder: Path, rng: np.random.Generator, balance: SixBalance, time: Array, felt: Array) -> None:
    """The same run as gauge outputs at 3 deg, zeros, weighing records, and the load schedule."""
    bridges, noise = Bridges(), 1e-4

    def record(name: str, instants: Array, loads: Array, pitch: float, roll: float = 0.0) -> None:
        outputs = bridges.outputs(loads) + noise * rng.standard_normal(loads.shape)
        columns = {f"r{part} [mV/V]": outputs[:, i] for i, part in enumerate(NAMES)}
        still = {"pitch [rad]": np.full(instants.size, pitch), "roll [rad]": np.full(instants.size, roll)}
        table(folder / f"{name}.csv", instants, {**columns, **still})

    rest = np.arange(200) / 2000.0
    level = _weight(np.zeros(200), np.zeros(200))
    record("zero", rest, level, 0.0)
    at = np.radians(3.0)
    record("gauges", time, felt + _weight(np.full(time.size, at), np.zeros(time.size)), at)
    attitudes = [(p, 0.0) for p in (-12, -6, 6, 12)] + [(0.0, r) for r in (90, 180, 270)] + [(0.0, 0.0), (45.0, 0.0)]
    for number, (pitch, roll) in enumerate(np.radians(attitudes), 1):
        loads = _weight(np.full(200, pitch), np.full(200, roll))
        record(f"still_{number}", rest, loads, float(pitch), float(roll))
    _schedule(folder, rng, bridges, noise)


def _schedule(folder: Path, rng: np.random.Generator, bridges: Bridges, noise: float) -> None:
    """A load schedule: each load alone up and down both ways, pairs, and natural zeros."""
    lines = [",".join(["natural_zero", "series", *(f"{n} [{u}]" for n, u in zip(NAMES, UNITS, strict=True))])]
    lines[0] += "," + ",".join(f"r{name} [mV/V]" for name in NAMES)
    rows = [(1, "NZ", np.zeros(6)) for _ in range(8)]
    steps = (0.0, 0.33, 0.66, 1.0, 0.5, 0.0, -0.33, -0.66, -1.0, -0.5, 0.0)
    for place, name in enumerate(NAMES):
        rows += [(0, name, step * HALF_RANGE * np.eye(6)[place]) for step in steps]
    for i in range(6):
        for j in range(i + 1, 6):
            for sign in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                both = np.zeros(6)
                both[i], both[j] = sign[0] * HALF_RANGE[i], sign[1] * HALF_RANGE[j]
                rows += [(0, f"{NAMES[i]}{NAMES[j]}", step * both) for step in (0.0, 0.5, 1.0)]
    for zero, series, load in rows:
        outputs = bridges.outputs(load[None, :])[0] + noise * rng.standard_normal(6)
        cells = [f"{cell:.10g}" for cell in (*load, *outputs)]
        lines.append(",".join([str(zero), series, *cells]))
    (folder / "schedule.csv").write_text("\n".join(lines) + "\n")
