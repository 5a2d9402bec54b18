"""Recognising how a text file is laid out: preamble, header, units, separators, decimal signs, clock, text columns."""

import tomllib

import numpy as np
import pytest

from aerobalance.app.cli import main
from aerobalance.io import load_channel_map, read, read_table, template
from aerobalance.recording.errors import DataQualityWarning, ReadError

ROWS = [(i / 5000, round(0.5 + 0.25 * float(np.sin(i)), 4)) for i in range(100)]


def comma(value):
    return repr(value).replace(".", ",")


def written(folder, content, name="foreign.csv"):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def mapped(path, text):
    toml = path.with_suffix(".toml")
    toml.write_text(text, encoding="utf-8")
    return read(path, channel_map=load_channel_map(toml))


def proposed(path, **options):
    return tomllib.loads(template(path, **options))


def table(header, *, separator=";", number=comma, before="", after="", rows=ROWS):
    return before + header + "\n" + "".join(f"{number(t)}{separator}{number(x)}{after}\n" for t, x in rows)


TIMES = ["X_Value (s)", "Zeit [s]", "Temps (s)", "Tiempo [s]", "Tempo [s]", "t [s]", "Time axis (s)", "Zeitkanal [s]"]


@pytest.mark.parametrize("time", [*TIMES, "Time  1 - default sample rate [s]", "Uhr relativ [s]"])
def test_the_clock_is_found_in_many_languages(tmp_path, time):
    path = written(tmp_path, table(f"{time};AF [N]"))
    found = read(path)
    assert found.rate == pytest.approx(5000, rel=1e-9)
    assert found.channel("AF").values.tolist() == [x for _, x in ROWS]
    assert proposed(path)["file"]["time"] == time
    assert "rate" not in proposed(path)["file"]


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("µs", 1e6), ("min", 1 / 60), ("s", 1)])
def test_the_clock_may_be_in_any_unit_of_time(tmp_path, unit, factor):
    rows = [(round(t * factor, 12), x) for t, x in ROWS]
    found = read(written(tmp_path, table(f"Zeit [{unit}];AF [N]", rows=rows)))
    assert found.rate == pytest.approx(5000, rel=1e-6)


@pytest.mark.parametrize("header", ["X_Value;AF [N]", "Kanal0;AF [N]", "Zeit;AF [N]"])
def test_a_time_without_unit_is_refused_until_somebody_says_it(tmp_path, header):
    path = written(tmp_path, table(header))
    with pytest.raises(ReadError, match=r"time_unit|unit is missing"):
        read(path)
    text = template(path)
    assert tomllib.loads(text)["file"]["time"] == header.split(";")[0]
    assert '# time_unit = "?"  # unknown: the file does not say it (it steps by 0.0002)' in text
    with pytest.raises(ReadError, match=r"time_unit: is needed"):
        mapped(path, text)
    assert mapped(path, text.replace('# time_unit = "?"', 'time_unit = "ms"')).rate == pytest.approx(5e6)


def test_no_rate_is_invented(tmp_path):
    path = written(tmp_path, "AF [N];NF [N]\n" + "".join(f"{np.cos(i):.3f};{np.sin(i):.3f}\n" for i in range(50)))
    text = template(path)
    assert set(tomllib.loads(text)["file"]) == {
        "header_line",
        "skip_lines",
        "separator",
        "decimal",
    }  # ASCII: any encoding
    assert "1000" not in text
    with pytest.raises(ReadError, match=r"needs either time .* or rate"):
        mapped(path, text)


@pytest.mark.parametrize("header", ["X_Value (s);AF [N]", "X_Value;AF [N]"])
def test_a_rate_that_disagrees_with_the_times_is_warned_of(tmp_path, header):
    path = written(tmp_path, table(header))
    channel = '[channels.AF]\ncolumn = "AF [N]"\n'
    with pytest.warns(DataQualityWarning, match=r"the channel map says 1000 Hz, but column 1 \('X_Value.*put time = "):
        assert mapped(path, "[file]\nrate = 1000.0\n" + channel).rate == pytest.approx(1000)
    assert mapped(path, "[file]\nrate = 5000.0\n" + channel).rate == pytest.approx(5000)


@pytest.mark.parametrize(
    ("line", "rate"),
    [
        ("Abtastrate;5000 Hz", 5000),
        ("Abtastrate [kHz]: 5", 5000),
        ("Sample rate: 5.000 kHz", None),  # five or five thousand: nobody can know
        ("Sampling Frequency = 5 kS/s", 5000),
        ("Fréquence d'échantillonnage : 5000 Hz", 5000),
        ("Delta_X\t0.0002", 5000),
        ("dt = 0.2 ms", 5000),
        ("dt = 0.2", None),  # of what?
        ("# fs: 5000", 5000),
        ("Bearbeiter: 5000 Hz", None),
    ],
)
def test_a_rate_that_the_preamble_states_is_the_clock_of_a_file_without_times(tmp_path, line, rate):
    rows = "".join(f"{i};{np.cos(i):.0f}\n" for i in np.random.default_rng(1).integers(0, 99, 60))
    path = written(tmp_path, f"Protokoll\n{line}\n\nAF [N];NF [N]\n{rows}")
    if rate is None:
        assert "rate" not in proposed(path)["file"]
        with pytest.raises(ReadError, match=r"has no column time .*give the rate"):
            read(path)
        return
    with pytest.warns(DataQualityWarning, match="the clock is what line 2 states"):
        assert read(path).rate == rate
    assert proposed(path)["file"]["rate"] == rate


def test_a_preamble_that_disagrees_with_the_times_is_warned_of(tmp_path):
    path = written(tmp_path, table("Zeit [s];AF [N]", before="Lauf 3\nAbtastrate: 2000 Hz\n\n"))
    with pytest.warns(
        DataQualityWarning, match=r"line 2 says 2000 Hz, but column 1 .* 5000 Hz; the column of times is taken"
    ):
        assert read(path).rate == pytest.approx(5000)


def test_two_times_of_different_rates_are_refused(tmp_path):
    rows = "".join(f"{i / 100},{i},{i / 50},{i}\n" for i in range(30))
    with pytest.raises(ReadError, match=r"columns 1 \('time 1 \[s\]'\) and 3 .* are times of different rates"):
        read(written(tmp_path, "time 1 [s],AF [N],time 2 [s],pitch [deg]\n" + rows))


@pytest.mark.parametrize("lines", [0, 1, 7, 500, 5000])
@pytest.mark.parametrize("separator", [";", "\t"])
def test_preambles_of_any_length(tmp_path, lines, separator):
    before = "".join(f"Eintrag {i}{separator}{i}\n" for i in range(lines))
    path = written(tmp_path, table(f"Zeit [s]{separator}AF [N]", separator=separator, before=before))
    found = read(path)
    assert (found.samples, found.rate) == (100, pytest.approx(5000))
    assert proposed(path)["file"]["header_line"] == lines + 1


@pytest.mark.parametrize(
    ("header", "skipped"),
    [
        ("Zeit;AF\ns;N", 1),
        ("Zeit;AF\n[s];[N]", 1),
        ("Zeit;AF\n(s);(N)", 1),
        ("Zeit;AF\ns;N\n\n", 3),
        ("Zeit;AF\nseit Start;links vorn\ns;N", 2),
        ("Zeit;AF\ns;N\nseit Start;links vorn", 2),
        ("Zeit [s];AF [N]\n1;2\nKanal;Kanal", 2),
    ],
)
def test_rows_of_units_and_comments_under_the_names(tmp_path, header, skipped):
    path = written(tmp_path, table(header, before="Lauf 3\nBearbeiter;Größ\n"))
    found = read(path)
    assert found.channel("AF").file_unit == "N"
    assert (found.samples, found.rate) == (100, pytest.approx(5000))
    assert proposed(path)["file"]["header_line"] == 3
    assert proposed(path)["file"]["skip_lines"] == skipped
    assert proposed(path)["channels"]["AF"] == {"column": header.split("\n")[0].split(";")[1], "unit": "N"}


@pytest.mark.parametrize("stamp", ["12.03.2024 10:15:00,123", "Messung", "2024-03-12T10:15:00.5", "a.b 1.5"])
def test_decimal_commas_behind_columns_of_text(tmp_path, stamp):
    rows = "".join(f"{stamp};{comma(t)};{comma(x)}\n" for t, x in ROWS)
    path = written(tmp_path, f"Stempel;X_Value (s);AF [N]\n{rows}")
    with pytest.warns(DataQualityWarning, match=r"left out, for they hold no number: column 1 \('Stempel'\)$"):
        found = read(path)
    assert found.channel("AF").values.tolist() == [x for _, x in ROWS]
    assert list(found.channels) == ["AF"]
    assert proposed(path)["file"]["decimal"] == ","
    text = '[file]\ntime = "X_Value (s)"\n[channels.AF]\ncolumn = "AF [N]"\n'
    assert mapped(path, text).channel("AF").values.tolist() == [x for _, x in ROWS]


def test_text_that_comes_late_in_a_column_of_nothing_is_left_out_and_numbers_are_not(tmp_path):
    notes = ["", "gust"]
    rows = "".join(f"{t},{x},{notes[i == 90]},{i if i > 80 else ''}\n" for i, (t, x) in enumerate(ROWS))
    with pytest.warns(DataQualityWarning) as caught:
        found = read(written(tmp_path, "time [s],AF [N],remark,fan [rpm]\n" + rows))
    assert any("left out, for they hold no number: column 3 ('remark')" in str(item.message) for item in caught)
    assert found.channel("fan").values[81:].tolist() == list(range(81, 100))
    mixed = rows.replace("gust", "7").replace("99,", "99,b", 1)
    with pytest.raises(ReadError, match="is no number"):
        read(written(tmp_path, "time [s],AF [N],remark [1],fan [rpm]\n" + mixed[:-3] + "x\n"))


def test_text_in_a_channel_that_is_known_is_refused(tmp_path):
    with pytest.raises(ReadError, match=r"line 2, column 2 \('AF \[N\]'\): 'high' is no number"):
        read(written(tmp_path, "time [s],AF [N]\n0,high\n1,low\n2,low\n"))


def test_tables_of_points_may_hold_remarks(tmp_path):
    path = written(tmp_path, "pitch [deg],AF [N],remark\n0,1,first\n5,2,second\n")
    with pytest.warns(DataQualityWarning, match="column 3 .'remark'"):
        assert read_table(path).values("AF").tolist() == [1, 2]


@pytest.mark.parametrize(
    ("form", "match"),
    [
        ("2024-03-12T{h:02d}:{m:02d}:{s:07.4f}", "iso"),
        ("2024-03-12 {h:02d}:{m:02d}:{s:07.4f}+01:00", "iso"),
        ("12.03.2024 {h:02d}:{m:02d}:{s:07.4f}", "german"),
        ("12.3.24 {h:d}:{m:02d}:{s:07.4f}", "german"),
        ("3/12/2024 {h:d}:{m:02d}:{s:07.4f}", "american"),
        ("3/12/2024 {k:d}:{m:02d}:{s:07.4f} {half}", "american"),
        ("12-Mar-2024 {h:02d}:{m:02d}:{s:07.4f}", "month by name"),
        ("12 März 2024 {h:02d}:{m:02d}:{s:07.4f}", "month by name"),
        ("20240312T{h:02d}{m:02d}{s:07.4f}", "compact"),
        ("2024:072:{h:02d}:{m:02d}:{s:07.4f}", "day of year"),
        ("072:{h:02d}:{m:02d}:{s:07.4f}", "day of year"),
        ("{h:02d}:{m:02d}:{s:07.4f}", "time of day"),
    ],
)
@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.soak(first=13)
def test_stamps_become_seconds_since_the_first(tmp_path, form, match, decimal):
    def stamp(t):
        whole = 43199.99 + t  # over noon
        h, m = int(whole // 3600), int(whole % 3600 // 60)
        half = "PM" if h >= 12 else "AM"
        return form.format(h=h, m=m, s=round(whole % 60, 4), k=(h - 1) % 12 + 1, half=half).replace(".", decimal, 3)

    def row(t, x):
        made = stamp(t)
        if decimal == "," and match == "german":  # dots in the date stay
            date, clock = made.split(" ", 1)
            made = f"{date.replace(',', '.')} {clock.replace('.', ',')}"
        return f"{made};{repr(x).replace('.', decimal)}\n"

    path = written(tmp_path, "Wann;AF [N]\n" + "".join(row(t, x) for t, x in ROWS))
    found = read(path)
    np.testing.assert_allclose(found.stamps, [t for t, _ in ROWS], rtol=0, atol=1e-9)
    text = template(path)
    assert mapped(path, text).rate == found.rate == pytest.approx(5000, rel=1e-9)
    dated = match != "time of day" and not form.startswith("072")
    began = np.datetime64("2024-03-12T11:59:59.990") - np.timedelta64(3600 if "+01:00" in form else 0, "s")
    assert found.epoch == mapped(path, text).epoch == (began if dated else None)
    with pytest.raises(ReadError, match=r"file\.time_unit: does not go with 'Wann', which holds dates"):
        mapped(path, text.replace("[file]\n", '[file]\ntime_unit = "ms"\n'))


def test_stamps_go_on_over_midnight_and_months(tmp_path):
    days = ["30/01/2024 23:59:59.8", "30/01/2024 23:59:59.9", "31/01/2024 00:00:00.0", "31/01/2024 00:00:00.1"]
    found = read(written(tmp_path, "when;AF [N]\n" + "".join(f"{day};1\n" for day in days)))
    np.testing.assert_allclose(found.stamps, [0, 0.1, 0.2, 0.3], atol=1e-9)
    # The first of February after the thirty-first of January, day first or month first: one day has passed.
    for one, two in (("31.01.2024", "01.02.2024"), ("01/31/2024", "02/01/2024"), ("2024-01-31", "2024-02-01")):
        rows = f"{one} 23:59:59;1\n{two} 00:00:00;2\n{two} 00:00:01;2\n"
        assert read(written(tmp_path, f"when;AF [N]\n{rows}")).duration == pytest.approx(2)
    clock = "23:59:59,9;1\n00:00:00,0;2\n00:00:00,1;3\n"
    assert read(written(tmp_path, "Uhrzeit;AF [N]\n" + clock)).duration == pytest.approx(0.2)


def test_a_zone_that_changes_leaves_no_gap(tmp_path):
    rows = "".join(f"2024-03-31T{clock};1\n" for clock in ("01:59:59.9+01:00", "03:00:00.0+02:00", "03:00:00.1+02:00"))
    found = read(written(tmp_path, "when;AF [N]\n" + rows))
    np.testing.assert_allclose(found.stamps, [0, 0.1, 0.2], atol=1e-9)
    assert found.epoch == np.datetime64("2024-03-31T00:59:59.900")


def test_a_stamp_that_is_none_is_named_by_line(tmp_path):
    rows = [f"2024-03-12 10:15:{i:02d};1\n" for i in range(20)]
    rows[15] = "later;1\n"
    with pytest.raises(ReadError, match=r"line 17, column 1 \('when'\): 'later' is no date and time"):
        read(written(tmp_path, "when;AF [N]\n" + "".join(rows)))


def test_runs_of_spaces_separate(tmp_path):
    rows = "".join(f"  {t:10.4f}   {x:12.5e}  {-x:12.5e}\n" for t, x in ROWS)
    for header in (
        "time [s]   AF [N]   NF [N]",
        "time [s] AF [N] NF [N]",
        "time  AF  NF\ns  N  N",
        "time AF NF\n[s] [N] [N]",
    ):
        found = read(written(tmp_path, f"run 3 of today\n{header}\n{rows}", "x.txt"))
        np.testing.assert_allclose(found.channel("NF").values, [-x for _, x in ROWS], rtol=1e-5)
        assert found.rate == pytest.approx(5000)


def test_a_file_without_header_is_mapped_by_number(tmp_path):
    rows = "".join(f"{t:.4f} {x:.4f} 2.0\n" for t, x in ROWS)
    for before, skipped in (("", 0), ("Kraft und Winkel, Lauf 3\n\n", 2)):
        path = written(tmp_path, before + rows, "bare.txt")
        with pytest.raises(ReadError, match=r"holds numbers .*channel map, which `aerobalance map FILE` makes"):
            read(path)
        text = template(path)
        file = tomllib.loads(text)["file"]
        assert (file["header_line"], file["skip_lines"], file["separator"]) == (0, skipped, "space")
        text = text.replace('# time_unit = "?"', 'time_unit = "s"')
        for number, name, unit in ((2, "AF", "N"), (3, "pitch", "deg")):
            text = text.replace(f"# [channels.column_{number}]", f"[channels.{name}]")
            text = text.replace(f'# column = {number}\n# unit = "?"', f'column = {number}\nunit = "{unit}"')
        found = mapped(path, text)
        assert (found.samples, found.rate) == (100, pytest.approx(5000))
        np.testing.assert_allclose(found.channel("AF").values, [x for _, x in ROWS], atol=1e-15)


def test_a_comment_may_be_left_out_of_rows(tmp_path):
    rows = "".join(f"{t};{x}{';gust' if i == 70 else ''}\n" for i, (t, x) in enumerate(ROWS))
    assert read(written(tmp_path, f"time [s];AF [N];Kommentar\n{rows}")).samples == 100
    # A last column that is no comment lacks its cells: the header may belong to other columns.
    with pytest.raises(ReadError, match=r"has 2 cell\(s\).* header has 3.*header_line under \[file\]"):
        read(written(tmp_path, f"time [s];AF [N];NF [N]\n{rows}"))


def test_separators_at_the_ends_of_lines_and_empty_last_rows(tmp_path):
    path = written(tmp_path, table("Zeit [s];AF [N]", after=";") + ";;\n;;\n")
    assert read(path).samples == 100
    path = written(tmp_path, table("Zeit [s];AF [N];", after=";"))
    assert read(path).samples == 100


@pytest.mark.parametrize("late", [False, True])
def test_cp1252_whose_first_letter_comes_after_64_kilobytes(tmp_path, late):
    rows = "".join(
        f"{i / 1000:.3f};{i}.25;{'20 °C – später' if i in (0, 9000)[late:] else 'ok'}\n" for i in range(10000)
    )
    content = f"time [s];AF [N];remark\n{rows}".encode("cp1252")
    assert (b"\x96" in content[:65536]) != late
    with pytest.warns(DataQualityWarning, match="column 3"):
        found = read(written(tmp_path, content))
    assert found.samples == 10000
    assert proposed(tmp_path / "foreign.csv")["file"]["encoding"] == "cp1252"


def test_keys_of_the_map_override_what_is_recognised(tmp_path):
    rows = "".join(f"{t};{x};{2 * x}\n" for t, x in ROWS)
    path = written(tmp_path, "alt;b;c\nneu [s];d [N];e [N]\n" + rows)
    assert proposed(path)["file"]["header_line"] == 2
    text = '[file]\nheader_line = 1\ntime = "alt"\ntime_unit = "s"\n[channels.AF]\ncolumn = "c"\nunit = "N"\n'
    assert mapped(path, text).channel("AF").values[3] == 2 * ROWS[3][1]
    assert proposed(path, header_line=1)["file"]["header_line"] == 1
    with pytest.raises(ReadError, match="puts the header in 2000"):
        mapped(path, text.replace("header_line = 1", "header_line = 2000"))


def test_a_decimal_sign_that_is_wrong_is_told_with_what_to_do(tmp_path):
    path = written(tmp_path, table("Zeit [s];AF [N]"))
    text = '[file]\ntime = "Zeit [s]"\ndecimal = "."\n[channels.AF]\ncolumn = "AF [N]"\n'
    with pytest.raises(ReadError, match=r'is no number.*put decimal = "," under \[file\] of a channel map'):
        mapped(path, text)


def test_a_scale_of_zero_is_refused(tmp_path):
    path = written(tmp_path, table("Zeit [s];AF [N]"))
    with pytest.raises(ReadError, match=r"channels\.AF\.scale: must not be zero"):
        mapped(path, "[file]\ntime = 1\n[channels.AF]\ncolumn = 2\nscale = 0\n")


COLUMNS = {
    "AF [N]": "AF", "Axialkraft [N]": "AF", "Axial force (lbf)": "AF", "Force axiale [daN]": "AF", "rN1 [mV/V]": "rN1",
    "N1 [uV/V]": "rN1", "AF [mV/V]": "rAF", "Normalkraft (µV/V)": "rNF", "Nickmoment [Nm]": "PM", "pitch [°]": "pitch",
    "Nickwinkel (deg)": "pitch", "Rollwinkel [rad]": "roll", "Temperatur [°C]": "temperature", "Speisespannung [V]":
    "excitation", "ground_acceleration [g]": "ground_acceleration",
}  # fmt: skip
DOUBTFUL = {
    "Fx [N]": "AF (positive aft", "alpha [deg]": "pitch, where", "Brücke 1 [mV/V]": "a gauge output",
    "a_x [g]": "acceleration", "Kraft [N]": "a load",
    "AF [m]": "the unit is that of something else", "rAF [V]": "with excitation",
    "Axialkraft": "AF", "fan [rpm]": "",
}  # fmt: skip


@pytest.mark.parametrize("label", COLUMNS)
def test_a_column_is_proposed_where_name_and_unit_leave_no_doubt(tmp_path, label):
    path = written(tmp_path, table(f"Zeit [s];{label}"))
    (name,) = proposed(path)["channels"]
    assert name == COLUMNS[label]
    found = mapped(path, template(path))
    assert found.channel(name).values.size == 100


@pytest.mark.parametrize("label", DOUBTFUL)
def test_a_column_is_unassigned_where_a_person_has_to_say_what_it_is(tmp_path, label):
    path = written(tmp_path, table(f"Zeit [s];{label}"))
    assert "channels" not in proposed(path)
    assert "# [channels.column_2]  # unassigned" + ("; perhaps " if DOUBTFUL[label] else "") in template(path)
    assert DOUBTFUL[label] in template(path)
    with pytest.raises(ReadError, match=r"channels: is missing; give one column or more a table \[channels\.NAME\]"):
        mapped(path, template(path))


def test_two_columns_that_may_be_one_channel_are_unassigned(tmp_path):
    rows = "".join(f"{t};{x};{x}\n" for t, x in ROWS)
    path = written(tmp_path, f"Zeit [s];Axialkraft [N];AF [N]\n{rows}")
    assert "channels" not in proposed(path)


def test_an_unknown_unit_is_told_as_unknown(tmp_path):
    path = written(tmp_path, table("Zeit [s];Kraft\n"))
    assert '# unit = "?"  # unknown: the file does not say it' in template(path)
    assert '"N"' not in template(path)
    path = written(tmp_path, table("Zeit [s];Kraft [Digits]"))
    assert '# unit = "Digits"  # not a unit that is known' in template(path)


def test_times_that_agree_with_the_preamble_in_another_unit_only_are_refused(tmp_path):
    milli = "".join(f"{0.2 * i:.1f};{np.cos(i):.3f}\n" for i in range(60)).replace(".", ",")
    path = written(tmp_path, "Lauf 3\nAbtastrate: 5000 Hz\n\nZeit [s];AF [N]\n" + milli)
    refusal = (
        r"column 1 \('Zeit \[s\]'\): steps by 0.2 s, which is 5 Hz, but line 2 says 5000 Hz: the times are in ms, "
        r'or one of the two is wrong\. Allowed are .* time = "Zeit \[s\]" and time_unit = "ms"'
    )
    with pytest.raises(ReadError, match=refusal):
        read(path)
    channel = '[channels.AF]\ncolumn = "AF [N]"\n'
    with pytest.raises(ReadError, match="5 Hz, but the channel map says 5000 Hz: the times are in ms"):
        mapped(path, "[file]\nrate = 5000.0\n" + channel)
    assert mapped(path, '[file]\ntime = "Zeit [s]"\ntime_unit = "ms"\n' + channel).rate == pytest.approx(5000)
    assert proposed(path)["file"]["time"] == "Zeit [s]"  # the map that the message asks for can be made


def test_the_command_takes_a_header_line(tmp_path, capsys):
    path = written(tmp_path, "Kopf;eins\nZeit [s];AF [N]\n0,5;1\n1,0;2\n1,5;3\n")
    assert main(["map", str(path), "--header-line", "1"]) == 0
    assert tomllib.loads(capsys.readouterr().out)["file"]["header_line"] == 1
    assert main(["map", str(path)]) == 0
    assert tomllib.loads(capsys.readouterr().out)["file"]["header_line"] == 2


def test_a_rate_of_the_map_and_one_of_the_preamble_are_compared(tmp_path):
    content = "Abtastrate: 5000 Hz\nAF [N];NF [N]\n" + "".join(
        f"{np.cos(i):.3f};0,5\n".replace(".", ",") for i in range(50)
    )
    path = written(tmp_path, content)
    channel = '[channels.AF]\ncolumn = "AF [N]"\n'
    with pytest.warns(
        DataQualityWarning, match="the channel map says 1000 Hz, but line 1 says 5000 Hz; the channel map is taken"
    ):
        assert mapped(path, "[file]\nrate = 1000.0\n" + channel).rate == pytest.approx(1000)
    with pytest.warns(DataQualityWarning, match="the clock is what line 1 states"):
        assert mapped(path, channel).rate == 5000
