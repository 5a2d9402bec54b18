"""Damaged files of every binary format: no crash, no hang, no memory beyond measure, and the place is said."""

from helpers.foreign_files import FILES, wav
from helpers.mutations import trial, without_place
from seeds import trials

CHOSEN = (
    *("packed.mat", "plain.mat", "new.mat", "paths.h5", "four.nc", "three.nc", "three.zarr", "columns.parquet"),
    *("columns.feather", "plain.mf4", "packed.mf4", "text.uff", "binary.uff"),
)


def test_damaged_files_are_refused_or_read_within_bounds(tmp_path, seed) -> None:
    for given in FILES:
        given.make(tmp_path / given.name)
    count = trials(8, 1000)
    found = trial([tmp_path / name for name in CHOSEN], tmp_path / "damaged", count=count, seed=seed)
    assert found.faults == []
    assert found.read + found.refused == count * len(CHOSEN)
    # packed formats have checksums or fall apart; of the others a share stays readable
    assert 0.05 * count * len(CHOSEN) < found.read < 0.6 * count * len(CHOSEN)
    assert without_place(found.words) == []


def test_damaged_wav_is_refused_or_read_within_bounds(tmp_path, seed) -> None:
    wav(tmp_path / "a.wav")
    toml = tmp_path / "map.toml"
    toml.write_text('[channels.AF]\ncolumn = "channel 1"\nunit = "N"\n')
    count = trials(25, 1000)
    found = trial([tmp_path / "a.wav"], tmp_path / "damaged", count=count, seed=seed, channel_map=toml)
    assert found.faults == []
    assert found.read > count / 6
    assert found.refused > count / 6
