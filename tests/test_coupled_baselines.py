"""Other ways from balance load to force on coupled components, and the command compare."""

from __future__ import annotations

import json
import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerobalance.app.cli import main
from aerobalance.app.commands.compare import compare
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.estimation.coupled_record import CoupledRecord
from aerobalance.io import write_recording
from aerobalance.io.dynamics_file import write_dynamics
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import STANDARD_GRAVITY, si_unit
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.recording.recording import Recording
from aerobalance.validation.baselines import THIS, BaselineSettings
from aerobalance.validation.coupled_baselines import TUNED, estimates_of_coupled
from aerobalance.validation.coupled_baselines import _Component as Compared
from aerobalance.validation.scores import Truth
from helpers.coupled_pair import NOISE, RATE, SIZE, band, colored, pair, recording_of, shaken

EXACT = replace(pair(), covariance=np.zeros((8, 8)))


def test_own_response_is_the_diagonal_of_the_whole_where_damping_does_not_couple_modes() -> None:
    A = EXACT.inertia
    # D = alpha A + beta 1 has the modes of A
    dynamics = CoupledDynamics(EXACT.components, A, 6.0 * A + 2e-5 * np.eye(2))
    frequency = np.linspace(0, 500, 1001)
    whole = dynamics.response(frequency)
    for place, name in enumerate(dynamics.components):
        found = dynamics.own_response(name)
        assert found.response(frequency) == pytest.approx(whole[:, place, place], rel=1e-9, abs=1e-9)
        assert found.natural_frequency == pytest.approx(dynamics.modes[0].natural_frequency)


def test_a_mode_that_does_not_oscillate_is_refused() -> None:
    dynamics = CoupledDynamics(EXACT.components, EXACT.inertia, 100 * EXACT.damping)
    with pytest.raises(FitError, match="does not oscillate"):
        dynamics.own_response("NF")


@pytest.mark.filterwarnings("ignore:.* shows turning")  # the pair is pitched for its weight alone
def test_every_baseline_method_on_a_component(rng) -> None:
    force, felt, pitch = shaken(rng, EXACT)
    recording = recording_of(felt + NOISE * rng.normal(size=felt.shape), pitch=pitch)
    truths = {"PM": Truth.of(force[:, 1], rate=RATE, natural_frequency=60.0)}
    found = estimates_of_coupled(recording, EXACT, components=("PM",), truths=truths)
    for name, rows in found.items():
        error = {(row.name, row.oracle): truths[name].score(row.values).rms for row in rows if row.ran}
        missing = {row.name: row.lacking for row in rows if not row.ran}
        assert list(missing) == ["accelerometer correction"], missing
        assert "no meaning for a moment" in missing["accelerometer correction"]
        assert {row for row, oracle in error if oracle} == set(TUNED) - set(missing)
        own = error.pop((THIS, False))
        # the bound is that of the best linear estimate; what ran beside it is worse
        assert own < 1.05 * min(error.values()), name
        # the other component's force, as large as its own, stays in what the diagonals give
        assert error[f"{THIS}, diagonal", False] > 3 * own, name
        assert error["band-limited inverse, diagonal", True] > 3 * error["band-limited inverse, coupled", True]


@pytest.mark.soak(first=0)
def test_differences_of_all_readings_undo_the_coupling(rng) -> None:
    force, felt, _ = shaken(rng, EXACT, pitching=False)
    recording = recording_of(felt + 1e-3 * NOISE * rng.normal(size=felt.shape))
    with warnings.catch_warnings():
        # so little noise lets errors of the simulation be seen: doubted as a faint floor, or as what is not explained
        warnings.filterwarnings("ignore", message=".*so faint that", category=DataQualityWarning)
        warnings.filterwarnings("ignore", message=".*depart from what the model", category=DataQualityWarning)
        found = estimates_of_coupled(recording, EXACT, components=("NF",))["NF"]
    values = {row.name: row.values for row in found if row.ran}
    inner = slice(100, -100)
    # three-point differences lose (w h)^2 / 12 of A X'' and (w h)^2 / 6 of D X', at 250 Hz and 4 kHz 1.3 and 2.6 %,
    # of terms that reach six times the force; a thousandth of the noise is amplified to 1e-4 of the force
    error = np.abs(values["central differences, coupled"] - force[:, 0])[inner]
    assert np.max(error) < 0.15 * np.max(np.abs(force[:, 0]))
    apart = np.abs(values["central differences, diagonal"] - force[:, 0])[inner]
    assert np.max(apart) > 3 * np.max(error)


def test_baseline_methods_take_declared_delays_into_account() -> None:
    """Channels read late, and said to be, give every baseline method what the same readings in time give it."""
    late, generator = 12, np.random.default_rng(7)  # samples
    dynamics = replace(EXACT, mass=replace(EXACT.mass, covariance=np.zeros((10, 10))))
    count = 3000 + late
    begun = np.clip(np.arange(count) / 200 - 0.5, 0, 1)  # from rest, so that there is no free motion of before
    ground = 5 * begun * band(generator, 250, count=count, rate=RATE, columns=1)[:, 0]
    ground += 1e-3 * generator.normal(size=count)
    force = 0.03 * SIZE * band(generator, 250, count=count, rate=RATE, columns=2)
    felt = dynamics.balance_load(force, interval=1 / RATE) + NOISE * generator.normal(size=force.shape)

    def shaken_with(loads: Array, shaking: Array, delay: float = 0.0) -> Recording:
        still = recording_of(loads, delay=delay)
        moving = Channel("ground_acceleration_z", shaking, "m/s^2", noise=1e-3)
        return replace(still, channels={**still.channels, moving.name: moving})

    felt += CoupledRecord.of(shaken_with(felt, ground), dynamics).from_ground

    def of(loads: Array, delay: float) -> dict[str, Array]:
        found = estimates_of_coupled(shaken_with(loads, ground[late:], delay), dynamics, components=("NF",))["NF"]
        return {row.name: row.values for row in found if row.ran}

    in_time, delayed = of(felt[late:], 0.0), of(felt[:-late], late / RATE)
    for name in ("low-pass", "notch and low-pass", "central differences, coupled"):
        # in one they begin and end `late` samples earlier; what the filters do there fades: exp(-2 pi 20 Hz / 10)
        apart = delayed[name][late:] - in_time[name][:-late]
        assert np.max(np.abs(apart[1000:-1000])) < 1e-3 * np.max(np.abs(in_time[name])), name


@pytest.mark.filterwarnings("ignore:.* shows turning")
def test_a_gap_of_the_pitch_is_bridged_and_not_level(rng) -> None:
    _, felt, pitch = (part[:1000] for part in shaken(rng, EXACT))
    recording = recording_of(felt + NOISE * rng.normal(size=felt.shape), pitch=pitch)
    lacking = recording_of(felt, pitch=np.where(np.arange(1000) // 10 == 50, np.nan, pitch))
    record = CoupledRecord.of(recording, EXACT)
    whole, bridged = (
        Compared(replace(record, recording=one), felt, {}, 0).raw(one, EXACT.own_response("NF"), BaselineSettings())
        for one in (recording, lacking)
    )
    # a line over 2.5 ms of 0.05 rad at 3 Hz is h^2 / 8 (6 pi)^2 0.05 = 1.4e-5 rad off; a level balance, 0.1 rad
    limit = EXACT.mass.mass * STANDARD_GRAVITY * np.max(np.abs(np.sin(pitch))) * 2e-5
    assert np.max(np.abs(bridged.values - whole.values)) < limit


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rng, seed) -> int:
    """A folder with a run of two components, its truth, a record of noise and the dynamics; the seed."""
    monkeypatch.chdir(tmp_path)
    force, felt, _ = (part[:1000] for part in shaken(rng, pair(), pitching=False))
    corners = (20.0, 0.0)
    write_recording(Path("run.csv"), recording_of(felt + colored(rng, corners, len(felt))))
    write_recording(Path("calm.csv"), recording_of(colored(rng, corners, 10 * len(felt))))
    columns = {name: Channel(name, column, si_unit(name)) for name, column in zip(("NF", "PM"), force.T, strict=True)}
    write_recording(Path("truth.csv"), Recording.from_columns(np.arange(len(felt)) / RATE, columns))
    write_dynamics(Path("dynamics.json"), pair())
    return seed


def test_the_command_has_one_table(here: int) -> None:
    ranges = dict(zip(("NF", "PM"), SIZE.tolist(), strict=True))
    out, truth = Path("page.html"), Path("truth.csv")
    account = compare(Path("run.csv"), dynamics=Path("dynamics.json"), truth=truth, half_range=ranges, out=out)
    rows = {(row["name"], row["setting"]): row for row in account["table"]}
    assert set(rows[THIS, "customary"]["numbers"]) == {"NF", "PM"}
    part = account["components"]["NF"]
    own = next(row for row in part["rivals"] if row["name"] == THIS)
    assert rows[THIS, "customary"]["numbers"]["NF"] == pytest.approx(100 * own["rms"] / SIZE[0])
    assert list(rows["accelerometer correction", "customary"]["not_run"].values()) == [["NF"], ["PM"]]
    page = Path("page.html").read_text()
    assert "<svg" in page
    assert not re.search(r"https?://|<script|url\((?!#)|src=", page)
    for name, _ in rows:
        assert name in page
    assert "central differences, coupled" in account["summary"]


@pytest.mark.parametrize(
    ("line", "code", "words"),
    [
        ("--half-range 5", 2, "NF=2000"),
        ("--step run.csv", 2, "name that one of NF, PM"),
        ("--component AF", 1, "has no AF; it has NF, PM"),
    ],
)
def test_refused_with_a_reason(
    here: int, capsys: pytest.CaptureFixture[str], *, line: str, code: int, words: str
) -> None:
    assert main(["compare", "run.csv", "--dynamics", "dynamics.json", *line.split()]) == code
    assert words in capsys.readouterr().err


def test_force_with_a_record_of_noise_and_monte_carlo(here: int, capsys: pytest.CaptureFixture[str]) -> None:
    line = ["force", "run.csv", "--dynamics", "dynamics.json", "-o", "force.csv", "--noise-record", "calm.csv"]
    assert main([*line, "--monte-carlo", "15", "--json"]) == 0, here
    account = json.loads(capsys.readouterr().out)
    for name in ("NF", "PM"):
        part = account["components"][name]
        assert "record of noise" in part["method"]
        assert part["noise_spectrum"]["white"]["value"] > 0
        row = part["monte_carlo"]["contributions"]["inertia, damping and mass"]
        # 14 of 15 in the mean square: fifteen draws of eleven numbers have exactly their covariance
        assert row["ratio"] == pytest.approx(np.sqrt(14 / 15), rel=0.03), here
