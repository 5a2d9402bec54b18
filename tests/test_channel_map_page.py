"""The page on channel maps has every key, and its examples are what the program takes."""

import re
import tomllib
from pathlib import Path

import pytest

from aerobalance.io.channel_map import FileLayout, MappedChannel, MappedFilter, MappedSensitivity, load_channel_map

PAGE = (Path(__file__).parents[1] / "docs" / "channel-map.md").read_text(encoding="utf-8")
FILE, CHANNELS = (
    PAGE.split(f"## {title}", 1)[1].split("\n## ", 1)[0] for title in ("Table `[file]`", "Tables `[channels")
)


def rows(part):
    return {
        cells[1].strip(" `"): cells for line in part.splitlines() if (cells := line.split("|"))[1:] and "`" in cells[1]
    }


@pytest.mark.parametrize(("part", "model"), [(FILE, FileLayout), (CHANNELS, MappedChannel)])
def test_every_key_has_a_row_and_no_row_is_of_another(part, model):
    assert set(rows(part)) == set(model.model_fields)
    for cells in rows(part).values():
        assert len(cells) == 7
        assert all(cell.strip() for cell in cells[1:-1])


@pytest.mark.parametrize("model", [MappedFilter, MappedSensitivity])
def test_the_keys_inside_a_key_are_told(model):
    told = rows(CHANNELS)["filter" if model is MappedFilter else "cross_axis"][2]
    assert set(model.model_fields) <= set(re.findall(r"`(\w+)`", told))


def test_every_example_is_taken():
    found = {key: tomllib.loads(cells[5].strip().strip("`"))[key] for key, cells in rows(FILE).items()}
    FileLayout.model_validate(found)
    found = {key: tomllib.loads(cells[5].strip().strip("`"))[key] for key, cells in rows(CHANNELS).items()}
    MappedChannel.model_validate({key: tuple(value) if key == "place" else value for key, value in found.items()})


def test_the_whole_example_is_a_map(tmp_path):
    (tmp_path / "map.toml").write_text(PAGE.split("## An example", 1)[1].split("```")[1], encoding="utf-8")
    assert set(load_channel_map(tmp_path / "map.toml").channels) == {"rAF", "pitch"}
