"""Where a warning points to: the line of the user that brought it about, however deep it is found."""

import numpy as np
import pytest

from aerobalance.app.commands.recordings import info
from aerobalance.recording.channel import Channel
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.recording import Recording

TIMES = np.delete(np.arange(40) / 100.0, slice(10, 14))


def by_library(folder):
    Recording.from_columns(TIMES, {"AF": Channel("AF", np.ones(TIMES.size), "N")}, name="gappy")


def by_command(folder):
    path = folder / "gappy.csv"
    path.write_text("time [s],AF [N]\n" + "".join(f"{time},1\n" for time in TIMES))
    info(path)


@pytest.mark.parametrize("call", [by_library, by_command])
def test_a_warning_points_to_the_line_outside_the_package(call, tmp_path):
    with pytest.warns(DataQualityWarning) as told:
        call(tmp_path)
    assert {warning.filename for warning in told} == {__file__}
