"""How fast plain files are read, beside a plain parser in the same run."""

from __future__ import annotations

import csv
from statistics import median
from time import perf_counter

import numpy as np
import pytest

from aerobalance.io import read, write_recording
from aerobalance.recording.channel import Channel
from aerobalance.recording.recording import Recording


def with_csv_module(path):
    """Read the numbers of a file as a script would do it without a library of numbers."""
    with path.open(encoding="utf-8", newline="") as lines:
        rows = csv.reader(lines)
        next(rows)
        return np.array([[float(cell) for cell in row] for row in rows])


def seconds(task):
    begin = perf_counter()
    task()
    return perf_counter() - begin


@pytest.mark.alone
def test_csv_beside_a_plain_parser(tmp_path, record, seed) -> None:
    path = tmp_path / "long.csv"
    values = np.random.default_rng(seed).normal(size=150_000)
    stamps = np.arange(values.size) / 25_000
    write_recording(path, Recording.from_columns(stamps, {"AF": Channel("AF", values, "N")}))
    np.testing.assert_array_equal(read(path).channel("AF").values, values)
    np.testing.assert_array_equal(with_csv_module(path)[:, 1], values)
    gain = median(seconds(lambda: with_csv_module(path)) / seconds(lambda: read(path)) for _ in range(5))
    print(f"{values.size} rows read {gain:.1f} times as fast as by csv and float()")  # noqa: T201
    record("time of csv and float() over the time of read, 150,000 rows", gain, 1.0)
    assert gain > 1.0  # all its checks of form, units and time stamps included
