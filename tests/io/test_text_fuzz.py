"""Text files that are mutated or made of odd parts: a recording or a read error, and never a long wait."""

import time
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from aerobalance.io import load_channel_map, read, template
from aerobalance.recording.errors import DataQualityWarning, ReadError
from helpers.text_exports import EXPORTS
from seeds import trials

PARTS = st.sampled_from(
    [
        *(
            "time [s]",
            "X_Value (s)",
            "Zeit",
            "AF [N]",
            "Brücke 1 (mV/V)",
            "s",
            "N",
            "[mV/V]",
            "°",
            "Kommentar",
            "",
            "-",
            "\ufeff",
        ),
        *("0", "0,5", "1.5", "1e3", "-2,5e-3", "1.2.3", "1e999", "NaN", "inf", "5000 Hz", "Abtastrate", "dt = 0.2 ms"),
        *("12.03.2024 10:15:00,123", "2024-03-12T10:15:00", "31/02/2024 25:61:61", "10:15:00 PM", "9/9/99 1:00:00"),
        *(
            '"',
            "'",
            "\x00",
            "\x1a",
            "\u2028",
            "***End_of_Header***",
            "LabVIEW Measurement",
            "(" * 50,
            "[" * 50,
            "m^9^9^9",
        ),
    ]
)
SIGNS = st.sampled_from([";", ",", "\t", " ", "  ", ";;", "\n", "\r\n", "\n\n", "\r"])


def outcome(path):
    """Whether a file can be read, or through the map proposed for it; all else must be a read error."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        ends = []
        for way in (read, mapped):
            try:
                ends.append(way(path).samples >= 2)
            except ReadError as error:
                assert path.stem in str(error)
                ends.append(False)
    return any(ends)


def mapped(path):
    toml = path.with_suffix(".toml")
    toml.write_text(template(path), encoding="utf-8")
    return read(path, channel_map=load_channel_map(toml))


@settings(max_examples=80, deadline=None, derandomize=True)
@given(
    parts=st.lists(st.tuples(PARTS, SIGNS), min_size=1, max_size=60),
    encoding=st.sampled_from(["utf-8", "cp1252", "utf-16"]),
)
def test_files_of_odd_parts(tmp_path_factory, parts, encoding):
    path = tmp_path_factory.mktemp("odd") / "odd.csv"
    path.write_bytes("".join(part + sign for part, sign in parts).encode(encoding, errors="replace"))
    outcome(path)


@pytest.mark.parametrize("export", EXPORTS, ids=[make.__name__ for make in EXPORTS])
def test_mutated_exports(tmp_path, export):
    given_file = export()
    rng = np.random.default_rng(list(given_file.name.encode()))
    path = tmp_path / given_file.name
    read_ones = 0
    for _ in range(trials(9, 25)):
        content = bytearray(given_file.content)
        for _ in range(rng.integers(1, 4)):
            at, size = int(rng.integers(min(len(content), 3000))), int(rng.integers(0, 40))
            if rng.random() < 0.5:
                content[at : at + size] = b""
            else:
                content[at:at] = bytes(
                    rng.choice([10, 13, 59, 44, 9, 34, 46, 48, 91, 0xE4], size=size % 5).astype(np.uint8)
                )
        path.write_bytes(content)
        read_ones += outcome(path)
    assert read_ones > 0


@pytest.mark.parametrize(
    "content",
    [
        b"a;b\n" * 300_000,
        b"Eintrag;1\n" * 300_000,
        b"x" * 3_000_000,
        b"(" * 300_000 + b"\n1;2\n3;4\n",
        b"1" * 1_000_000 + b"\n" + b"2" * 1_000_000,
        b";" * 300_000 + b"\n" + b"1;2\n" * 10,
        b"dt" + b" " * 500_000 + b"x\n1;2\n3;4\n",
        b"0.1 " * 500_000,
        b'"' + b"a,b\n" * 200_000,
    ],
    ids=["text", "pairs", "one line", "brackets", "digits", "separators", "spaces", "one row", "quote"],
)
def test_work_is_bounded_by_the_head_of_the_file(tmp_path, content):
    path = tmp_path / "long.csv"
    path.write_bytes(content)
    started = time.process_time()
    outcome(path)
    # A second or so on a free machine: what grows with the square of the length takes hours.
    assert time.process_time() - started < 30
