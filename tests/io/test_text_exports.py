"""Text exports of measuring programs come in by the map that is proposed, filled in with what the columns are."""

import tomllib
import warnings

import numpy as np
import pytest

from aerobalance.io import load_channel_map, read, template
from aerobalance.recording.errors import DataQualityWarning
from helpers.text_exports import BRIDGES, EXPORTS, GAUGES, PITCH, RATE, TIME, completed


@pytest.mark.parametrize("export", EXPORTS, ids=[make.__name__ for make in EXPORTS])
def test_an_export_reads_as_the_truth_when_only_the_columns_are_named(tmp_path, export):
    given = export()
    path, toml = tmp_path / given.name, tmp_path / "map.toml"
    path.write_bytes(given.content)
    toml.write_text(completed(template(path), given.names), encoding="utf-8")
    with warnings.catch_warnings():
        # LabVIEW writes stamps of milliseconds beside the interval, and the clock is what the preamble says.
        warnings.filterwarnings("ignore", "book.csv|export.txt: has no column of times", DataQualityWarning)
        found = read(path, channel_map=load_channel_map(toml))
    assert set(found.channels) == {*GAUGES, "pitch"}
    # Stamps are printed to 0.1 ms at best where they are the clock.
    assert found.rate == pytest.approx(RATE, rel=1e-6)
    np.testing.assert_allclose(found.time - found.start, TIME, rtol=0, atol=1e-9)
    # A cell in uV/V is rounded once more on its way to mV/V.
    values = np.column_stack([found.channel(name).values for name in GAUGES])
    np.testing.assert_allclose(values, BRIDGES, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found.channel("pitch").values, np.radians(PITCH), rtol=4e-16)


@pytest.mark.parametrize("export", EXPORTS, ids=[make.__name__ for make in EXPORTS])
def test_the_proposed_map_is_toml_and_switches_on_no_unit_or_rate_that_the_file_does_not_say(tmp_path, export):
    given = export()
    path = tmp_path / given.name
    path.write_bytes(given.content)
    contents = tomllib.loads(template(path))
    assert contents["file"].get("rate", RATE) == RATE
    content = given.content.decode("utf-16" if given.content[:1] == b"\xff" else "cp1252", errors="replace")
    for table in contents.get("channels", {}).values():
        assert table["unit"].encode().decode("cp1252", errors="replace") in content or table["unit"] in content
