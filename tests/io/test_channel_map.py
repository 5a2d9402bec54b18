"""The channel map for foreign files."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from aerobalance.app.commands.recordings import convert
from aerobalance.io import load_channel_map, read, template, write_recording
from aerobalance.recording.analog_filter import AntiAlias
from aerobalance.recording.channel import CrossAxis
from aerobalance.recording.errors import DataQualityWarning, ReadError

TREADMILL = Path(__file__).parents[3] / "shared" / "data" / "treadmill"

MAP = """
[file]
time = "Timestamp (s)"
[channels.PM]
column = "Pitch Moment (Nm)"
[channels.ground_acceleration]
column = "Belt Velocity (m/s)"
derivative = 1
sign = -1
"""


def mapped(folder, text, data, name="foreign.txt"):
    (folder / "map.toml").write_text(text, encoding="utf-8")
    path = folder / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return read(path, channel_map=load_channel_map(folder / "map.toml"))


def belt(count=50, rate=100.0):
    time = np.arange(count) / rate
    rows = "".join(f"{t:.17g}\t{3 * t:.17g}\t{t * t:.17g}\n" for t in time)
    return "Timestamp (s)\tPitch Moment (Nm)\tBelt Velocity (m/s)\n" + rows


def test_a_velocity_becomes_an_acceleration(tmp_path):
    recording = mapped(tmp_path, MAP, belt())
    time = np.arange(50) / 100
    found = recording.channel("ground_acceleration")
    assert found.unit == "m/s^2"
    # Central differences are exact for a parabola but at the ends, where they are one-sided.
    np.testing.assert_allclose(found.values[1:-1], -2 * time[1:-1], rtol=1e-10)
    np.testing.assert_allclose(recording.channel("PM").values, 3 * time, rtol=1e-15)
    assert list(recording.channels) == ["PM", "ground_acceleration"]


def test_a_position_becomes_an_acceleration(tmp_path):
    text = MAP.replace("derivative = 1", "derivative = 2").replace('(m/s)"', '(m/s)"\nunit = "mm"')
    recording = mapped(tmp_path, text, belt())
    np.testing.assert_allclose(recording.channel("ground_acceleration").values, -2e-3, rtol=1e-8)


def test_derivatives_lose_the_neighbours_of_a_gap_and_say_so(tmp_path):
    lines = belt().splitlines()
    lines[20] = "\t".join([*lines[20].split("\t")[:2], ""])
    with pytest.warns(DataQualityWarning) as caught:
        recording = mapped(tmp_path, MAP, "\n".join(lines))
    assert any("1 more samples are missing after differentiation" in str(item.message) for item in caught)
    # The central difference at the lost sample needs its neighbours only; theirs need the lost one.
    assert np.flatnonzero(recording.channel("ground_acceleration").missing).tolist() == [18, 20]


def test_every_setting_reaches_the_channel(tmp_path):
    text = """
[file]
rate = 1000.0
separator = "semicolon"
decimal = ","
header_line = 3
skip_lines = 1
encoding = "cp1252"
[channels.AF]
column = 2
unit = "lbf"
scale = 10
offset = 1.5
sign = -1
noise = 0.5
relative_uncertainty = 0.01
delay = 1e-6
[channels.live_acceleration]
column = "a"
unit = "g"
coupling = "ac"
corner = 0.5
"""
    data = "Messung für N\nx\nt;F;a\n[°];[N];[x]\n0;0,5;1\ntext;1,5;2\n9;2,5;3\n".encode("cp1252")
    recording = mapped(tmp_path, text, data)
    pound = 0.45359237 * 9.80665
    axial = recording.channel("AF")
    np.testing.assert_allclose(axial.values, -(10 * np.array([0.5, 1.5, 2.5]) + 1.5) * pound, rtol=1e-15)
    assert axial.noise == pytest.approx(0.5 * pound)
    assert (axial.relative_uncertainty, axial.delay, axial.file_unit) == (0.01, 1e-6, "lbf")
    live = recording.channel("live_acceleration")
    assert (live.coupling, live.corner) == ("ac", 0.5)
    np.testing.assert_allclose(live.values, np.array([1, 2, 3]) * 9.80665, rtol=1e-15)
    assert recording.rate == pytest.approx(1000)


ACCELEROMETERS = """
[file]
rate = 1000.0
[channels.ground_acceleration]
column = 1
unit = "g"
noise = 0.001
delay = 1e-4
relative_uncertainty = 0.02
zero_uncertainty = 0.01
filter = { kind = "butterworth", order = 8, corner = "0.2 kHz" }
cross_axis = { ground_acceleration_z = 0.02, ground_acceleration_y = { value = 0, u = 0.03 } }
[channels.ground_acceleration_z]
column = 2
unit = "m/s^2"
filter = { kind = "bessel", order = 4, corner = 150 }
[channels.ground_acceleration_y]
column = 3
unit = "m/s^2"
coupling = "ac"
corner = 0.5
"""


def settings(recording):
    return {
        channel.name: {"unit": channel.unit, "file_unit": channel.file_unit, **channel.known()}
        for channel in recording
    }


def test_filter_and_cross_axis_reach_the_channel_and_survive_conversion(tmp_path):
    rows = "\n".join(f"{np.sin(k)},{np.cos(k)},{k % 3}" for k in range(50))
    recording = mapped(tmp_path, ACCELEROMETERS, f"x,z,y\n{rows}\n")
    ground, up, right = recording
    assert ground.filter == AntiAlias("butterworth", 8, 200.0)
    assert ground.cross_axis == (
        CrossAxis("ground_acceleration_z", 0.02),
        CrossAxis("ground_acceleration_y", 0.0, 0.03),
    )
    assert ground.zero_uncertainty == pytest.approx(0.01 * 9.80665)
    assert up.filter == AntiAlias("bessel", 4, 150.0)
    assert (right.filter, right.cross_axis) == (None, ())
    write_recording(tmp_path / "kept.h5", recording)
    again = read(tmp_path / "kept.h5")
    before, after = settings(recording), settings(again)
    for name, given in before.items():
        for slot, value in given.items():
            expected = pytest.approx(value, rel=1e-14) if isinstance(value, float) else value
            assert after[name][slot] == expected, (name, slot)
        np.testing.assert_allclose(again.channel(name).values, recording.channel(name).values, rtol=1e-14, atol=1e-16)


def test_conversion_to_text_says_what_it_loses(tmp_path):
    (tmp_path / "map.toml").write_text(ACCELEROMETERS)
    (tmp_path / "data.csv").write_text("x,z,y\n" + "\n".join(f"{np.sin(k)},{k % 5},{k % 3}" for k in range(50)) + "\n")
    with pytest.warns(DataQualityWarning, match=r"out\.csv has no place for how ground_acceleration, gr.* \.h5"):
        convert([tmp_path / "data.csv"], tmp_path / "out.csv", channel_maps=[tmp_path / "map.toml"])
    convert([tmp_path / "data.csv"], tmp_path / "out.h5", channel_maps=[tmp_path / "map.toml"])
    convert([tmp_path / "out.h5"], tmp_path / "again.h5")
    assert read(tmp_path / "again.h5").channel("ground_acceleration").filter is not None


def test_a_file_without_header_separated_by_spaces(tmp_path):
    text = """
[file]
time = 1
time_unit = "ms"
separator = "space"
header_line = 0
[channels.AF]
column = 2
unit = "N"
"""
    recording = mapped(tmp_path, text, "  0   1.5\n  1  2.5\n  2   3.5\n")
    assert recording.rate == pytest.approx(1000)
    assert recording.channel("AF").values.tolist() == [1.5, 2.5, 3.5]


CHANNEL = '[file]\nrate = 1.0\n[channels.AF]\ncolumn = 1\nunit = "N"\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", ["channels", "is missing"]),
        ("[file", ["is no TOML", "Expected ']'"]),
        ("[channels]\n[file]\nrate = 1.0\n", ["channels", "at least 1"]),
        (CHANNEL + "colour = 1\n", ["channels.AF.colour", "is not known", "column, unit, scale"]),
        (CHANNEL.replace("rate", "speed"), ["file.speed", "is not known", "time, time_unit, rate"]),
        (CHANNEL.replace('unit = "N"', "unit = 5"), ["channels.AF.unit", "must be a string", "5"]),
        (CHANNEL + 'scale = "ten"\n', ["channels.AF.scale", "number", "'ten'"]),
        (CHANNEL + "scale = nan\n", ["channels.AF.scale", "finite"]),
        (CHANNEL + "sign = 2\n", ["channels.AF.sign", "1 or -1", "2"]),
        (CHANNEL + "noise = -1\n", ["channels.AF.noise", "greater than or equal to 0"]),
        (CHANNEL + 'coupling = "magnetic"\n', ["channels.AF.coupling", "'kinematic', 'dc' or 'ac'", "magnetic"]),
        (CHANNEL + "derivative = 3\n", ["channels.AF.derivative", "0, 1 or 2"]),
        (CHANNEL + "derivative = 1\n", ["channels.AF", "derivative is for accelerations"]),
        (CHANNEL + "corner = 1.0\n", ["channels.AF.corner", 'coupling = "ac"']),
        (
            CHANNEL + 'filter = { kind = "elliptic", order = 8, corner = 500 }\n',
            ["channels.AF.filter.kind", "'bessel'"],
        ),
        (CHANNEL + 'filter = { kind = "bessel", order = 99, corner = 5 }\n', ["channels.AF.filter.order", "24"]),
        (CHANNEL + 'filter = { kind = "bessel", order = 4, corner = "5 N" }\n', ["AF.filter.corner", '"500 Hz"']),
        (CHANNEL + 'filter = { kind = "bessel", order = 4, corner = 0 }\n', ["AF.filter.corner", "greater than 0"]),
        (
            CHANNEL + "cross_axis = { pitch = 0.1 }\n",
            ["channels.AF.cross_axis.pitch", "cross_axis is for accelerations"],
        ),
        (CHANNEL.replace('"N"', '"kg"'), ["channels.AF.unit", "a force is expected", "lbf"]),
        (CHANNEL.replace("column = 1", "column = 0"), ["channels.AF.column", "0"]),
        (CHANNEL.replace("rate = 1.0", "rate = 1.0\ntime = 1"), ["file", "either time", "rate"]),
        (CHANNEL.replace("rate = 1.0", "rate = 0.0"), ["file.rate", "greater than 0"]),
        (CHANNEL.replace("rate = 1.0", 'time = 1\ntime_unit = "N"'), ["file.time_unit", "a time is expected"]),
        (CHANNEL.replace("rate = 1.0", 'rate = 1.0\nseparator = "|"'), ["file.separator", "'comma'"]),
        (CHANNEL.replace("channels.AF", "channels.time"), ["channels.time", "under [file]"]),
        ("[file]\nrate = 1.0\n[channels]\nAF = 3\n", ["channels.AF", "3"]),
    ],
)
def test_bad_maps_are_refused_with_key_and_what_is_allowed(tmp_path, text, said):
    path = tmp_path / "map.toml"
    path.write_text(text)
    with pytest.raises(ReadError) as caught:
        load_channel_map(path)
    for words in ["map.toml", *said]:
        assert words in str(caught.value)
    assert "\n" not in str(caught.value)


GAUGE = '[file]\nrate = 1.0\n[channels.rN1]\ncolumn = 1\nunit = "V"\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (GAUGE + "shunt_expected = 1.0\n", ["channels.rN1", "shunt_expected and shunt_measured", "needed together"]),
        (GAUGE + "shunt_measured = 1.0\n", ["channels.rN1", "needed together"]),
        (GAUGE + "shunt_expected = 1.0\nshunt_measured = 0.0\n", ["channels.rN1", "must not be zero"]),
        (GAUGE + "shunt_expected = 1.0\nshunt_measured = 0.8\n", ["rN1.shunt_measured", "1.25", "20%", "dead bridge"]),
        (GAUGE + "shunt_expected = 1.0\nshunt_measured = -1.0\n", ["rN1.shunt_measured", "ratio of -1", "sign"]),
        (GAUGE + "shunt_expected = 1.0\nshunt_measured = 1e-9\n", ["rN1.shunt_measured", "resistor"]),
        (GAUGE + "excitation = 0.0\n", ["channels.rN1.excitation", "greater than 0"]),
        (GAUGE.replace('"V"', '"mV/V"') + "excitation = 10.0\n", ["rN1.unit", "over excitation already"]),
        (GAUGE.replace('"V"', '"N"'), ["rN1.unit", "is a force", "uV/V", "excitation [V]"]),
        (CHANNEL + "excitation = 10.0\n", ["channels.AF", "for gauge outputs, such as rAF"]),
        (CHANNEL + "shunt_expected = 1.0\nshunt_measured = 1.0\n", ["channels.AF", "for gauge outputs"]),
        (CHANNEL.replace("rate = 1.0", "rate = 1.0\ntime = 1"), ["file", "not both"]),
    ],
)
def test_bad_gauge_settings(tmp_path, text, said):
    path = tmp_path / "map.toml"
    path.write_text(text)
    with pytest.raises(ReadError) as caught:
        load_channel_map(path)
    for words in ["map.toml", *said]:
        assert words in str(caught.value)


def test_a_text_file_needs_a_time_column_or_a_rate(tmp_path):
    with pytest.raises(
        ReadError, match=r"map\.toml: file: needs either time .* or rate .*: foreign\.txt does not state"
    ):
        mapped(tmp_path, CHANNEL.replace("rate = 1.0", ""), "F\n1\n2\n")


def test_shunt_readings_and_a_nominal_excitation(tmp_path):
    settings = "shunt_expected = 1.01\nshunt_measured = 1.0\nnoise = 1e-6\nrelative_uncertainty = 1e-3\n"
    volts = mapped(tmp_path, GAUGE + settings, "F\n0.001\n0.002\n").channel("rN1")
    assert (volts.unit, volts.file_unit) == ("V", "V")
    np.testing.assert_allclose(volts.values, [0.00101, 0.00202], rtol=1e-14)
    over = mapped(tmp_path, GAUGE + settings + "excitation = 5.0\n", "F\n0.001\n0.002\n").channel("rN1")
    assert (over.unit, over.file_unit) == ("mV/V", "mV/V")
    np.testing.assert_allclose(over.values, [0.202, 0.404], rtol=1e-14)
    assert (over.noise, over.relative_uncertainty) == (pytest.approx(1e-6 / 5 * 1e3 * 1.01), 1e-3)


@pytest.mark.parametrize(("measured", "doubted"), [(1.0, False), (0.981, False), (0.97, True), (1.19, True)])
def test_a_shunt_ratio_beyond_two_percent_is_doubted(tmp_path, measured, doubted):
    text = GAUGE.replace('"V"', '"mV/V"') + f"shunt_expected = 1.0\nshunt_measured = {measured}\n"
    if doubted:
        with pytest.warns(DataQualityWarning, match=r"foreign\.txt: the shunt readings multiply rN1 by"):
            found = mapped(tmp_path, text, "F\n1\n2\n")
    else:
        found = mapped(tmp_path, text, "F\n1\n2\n")
    np.testing.assert_allclose(found.channel("rN1").values, np.array([1, 2]) / measured, rtol=1e-14)


def test_temperatures_and_voltages_come_out_as_they_went_in(tmp_path):
    header = "time [s],temperature [degF],excitation [mV],rAx [uV],u_temperature [K]\n"
    path = tmp_path / "plain.csv"
    path.write_text(header + "0,32,9999.5,125,0.5\n1,212,10000,250,0.25\n2,-40,10000,250,0.25\n")
    recording = read(path)
    # Water freezes and boils at 32 and 212 degF; both scales meet at -40.
    np.testing.assert_allclose(recording.channel("temperature").values, [0, 100, -40], rtol=1e-14, atol=1e-13)
    np.testing.assert_allclose(recording.channel("excitation").values, [9.9995, 10, 10], rtol=1e-15)
    np.testing.assert_allclose(recording.channel("rAx").values, [125e-6, 250e-6, 250e-6], rtol=1e-15)
    assert recording.channel("u_temperature").values.tolist() == [0.5, 0.25, 0.25]
    write_recording(tmp_path / "again.csv", recording)
    again = np.loadtxt(tmp_path / "again.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(again, np.loadtxt(path, delimiter=",", skiprows=1), rtol=1e-15)
    assert (tmp_path / "again.csv").read_text().splitlines()[0] + "\n" == header


def test_missing_or_binary_map(tmp_path):
    with pytest.raises(ReadError, match="no such file"):
        load_channel_map(tmp_path / "none.toml")
    (tmp_path / "map.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ReadError, match="is no TOML"):
        load_channel_map(tmp_path / "map.toml")
    with pytest.raises(ReadError, match="is a folder; a file is needed"):
        load_channel_map(tmp_path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            ("Pitch Moment (Nm)", "Moment"),
            [r"no column 'Moment'", "'Timestamp (s)', 'Pitch Moment (Nm)'", "`aerobalance map FILE` makes"],
        ),
        (('"Pitch Moment (Nm)"', "7"), ["there is no column 7", "3 columns"]),
        (("channels.PM", "channels.AF"), ["column 2", "is a moment, but a force", "AF"]),
        (("Timestamp (s)", "Belt Velocity (m/s)"), ["column 3", "a time is expected"]),
        (("derivative = 1", ""), ["column 3", "is a velocity, but an acceleration"]),
    ],
)
def test_maps_that_do_not_fit_the_file(tmp_path, change, said):
    with pytest.raises(ReadError) as caught:
        mapped(tmp_path, MAP.replace(*change, 1), belt())
    for words in said:
        assert words in str(caught.value)


def test_a_header_without_unit_needs_one_in_the_map(tmp_path):
    text = '[file]\ntime = "t"\ntime_unit = "s"\n[channels.AF]\ncolumn = "F"\n'
    with pytest.raises(ReadError, match=r"map\.toml: channels\.AF\.unit: is needed: the header 'F'"):
        mapped(tmp_path, text, "t,F\n0,1\n1,2\n")
    with pytest.raises(ReadError, match=r"file\.time_unit: is needed"):
        mapped(tmp_path, text.replace('time_unit = "s"', ""), "t,F\n0,1\n1,2\n")


def test_two_columns_of_one_name_go_by_number(tmp_path):
    text = '[file]\nrate = 1.0\n[channels.AF]\ncolumn = "F"\nunit = "N"\n'
    with pytest.raises(ReadError, match="columns 1 and 2 are both called 'F'; give the number"):
        mapped(tmp_path, text, "F,F\n0,1\n1,2\n")
    found = mapped(tmp_path, text.replace('"F"', "2"), "F,F\n0,1\n1,2\n")
    assert found.channel("AF").values.tolist() == [1, 2]


def test_the_template_is_toml_and_completes_to_a_map(tmp_path):
    path = tmp_path / "foreign.txt"
    path.write_text(belt())
    text = template(path)
    layout = {
        "header_line": 1,
        "skip_lines": 0,
        "separator": "tab",
        "decimal": ".",
    }  # of plain letters, so any encoding
    assert tomllib.loads(text) == {
        "file": {"time": "Timestamp (s)", **layout},
        "channels": {"PM": {"column": "Pitch Moment (Nm)", "unit": "Nm"}},
    }
    text = text.replace("# [channels.column_3]", "[channels.ground_acceleration]")
    text = text.replace('# column = "', 'column = "').replace('# unit = "', 'unit = "')
    text = text.replace('unit = "m/s"', 'unit = "m/s"\nderivative = 1\nsign = -1')
    recording = mapped(tmp_path, text, belt())
    assert recording.rate == pytest.approx(100)


@pytest.mark.parametrize("header", ['time [s],AF [N],"odd "" \\ name",', "a;b;c", "Zeit\tKraft [kN]", "T,x (N)"])
def test_the_template_is_toml_for_any_header(tmp_path, header):
    path = tmp_path / "foreign.csv"
    path.write_text(header + "\n1,2,3,4\n")
    tomllib.loads(template(path))


def test_mapped_recordings_write_as_plain_ones(tmp_path):
    recording = mapped(tmp_path, MAP, belt())
    write_recording(tmp_path / "plain.csv", recording)
    again = read(tmp_path / "plain.csv")
    np.testing.assert_array_equal(
        again.channel("ground_acceleration").values, recording.channel("ground_acceleration").values
    )
    assert (tmp_path / "plain.csv").read_text().startswith("time [s],PM [Nm],ground_acceleration [m/s^2]\n")


@pytest.mark.skipif(not TREADMILL.is_dir(), reason="the real recordings are not here")
@pytest.mark.parametrize("speed", ["Slow", "Fast"])
def test_real_treadmill_recordings(tmp_path, speed):
    (tmp_path / "map.toml").write_text(MAP)
    with pytest.warns(DataQualityWarning, match="repeat the one before" if speed == "Fast" else "depart from a stead"):
        recording = read(TREADMILL / f"Random{speed}Speed1.txt", channel_map=load_channel_map(tmp_path / "map.toml"))
    assert recording.rate == pytest.approx(100, rel=1e-4)  # 100 Hz, says its description
    assert recording.duration == pytest.approx(350, abs=0.1)
    velocity = np.loadtxt(TREADMILL / f"Random{speed}Speed1.txt", skiprows=1)[:, 2]
    expected = -(velocity[2:] - velocity[:-2]) * recording.rate / 2
    np.testing.assert_allclose(recording.channel("ground_acceleration").values[1:-1], expected, atol=1e-9)


@pytest.mark.parametrize("order", [1, 2])
def test_noise_of_what_is_differentiated_is_that_of_the_result(order, tmp_path, rng):
    rate, noise, count = 1000.0, 1e-3, 20_000
    unit = "m/s" if order == 1 else "m"
    rows = (f"{k / rate:.4f},{k % 7},{value:.12f}" for k, value in enumerate(rng.normal(0, noise, count)))
    (tmp_path / "v.csv").write_text(f"time [s],AF [N],motion [{unit}]\n" + "\n".join(rows))
    (tmp_path / "m.toml").write_text(
        '[channels.AF]\ncolumn = "AF"\n[channels.ground_acceleration]\ncolumn = "motion"\n'
        f"derivative = {order}\nnoise = {noise}\n"
    )
    channel = read(tmp_path / "v.csv", channel_map=load_channel_map(tmp_path / "m.toml")).channel(
        "ground_acceleration"
    )
    # neighbours hang together: as if a third of the samples told the scatter, five deviations
    assert np.std(channel.values) == pytest.approx(channel.noise, rel=5 / np.sqrt(2 * count / 3))
