"""A file is written whole or not at all."""

import os
import stat

import pytest

from aerobalance.io.safe_write import replacing


def test_a_file_is_replaced_at_the_end_only(tmp_path):
    path = tmp_path / "out.json"
    path.write_text("old")
    with replacing(path) as beside:
        beside.write_text("new")
        assert beside.parent == tmp_path
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


class Interrupted(BaseException):
    """Stands for the operator's interrupt."""


@pytest.mark.parametrize("problem", [RuntimeError("x"), Interrupted()])
def test_nothing_is_left_over_on_failure(tmp_path, problem):
    path = tmp_path / "out.json"

    def fail():
        with replacing(path) as beside:
            beside.write_text("half")
            raise problem

    with pytest.raises(type(problem)):
        fail()
    assert list(tmp_path.iterdir()) == []
    path.write_text("old")
    with pytest.raises(type(problem)):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_missing_folder_and_folder_as_file(tmp_path):
    with pytest.raises(ValueError, match="there is no folder"), replacing(tmp_path / "none" / "out.json"):
        pass
    with pytest.raises(ValueError, match="is a folder"), replacing(tmp_path):
        pass


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write everywhere")
def test_closed_folder(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(ValueError, match="cannot write"), replacing(tmp_path / "out.json"):
        pass


def test_full_disk_is_a_clear_error(tmp_path):
    def fill():
        with replacing(tmp_path / "out.json"):
            raise OSError(28, "No space left on device")

    with pytest.raises(ValueError, match=r"cannot write .*out\.json: No space left"):
        fill()
    assert list(tmp_path.iterdir()) == []


def test_permissions_are_those_of_an_ordinary_file(tmp_path):
    with replacing(tmp_path / "out") as beside:
        beside.write_text("x")
    (tmp_path / "plain").write_text("x")
    modes = {stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("out", "plain")}
    assert len(modes) == 1
