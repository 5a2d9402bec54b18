"""A whole test of six components whose truth is known: good runs reduced, broken ones named, drift and change flagged.

``pytest -m long`` runs all 400; a few of them always.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from aerobalance.app.campaign.assignment import OF_RESULTS
from aerobalance.app.campaign.campaign import Campaign, reduce_runs
from aerobalance.app.campaign.engine import Engine
from aerobalance.io import read, write_recording
from helpers.whole_test import WholeTest, coverage, simulated_test

# of 400 runs some show by chance what is said once in thousands of records
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")


def judged(found: Campaign, test: WholeTest) -> None:
    """What holds however few runs there are."""
    assert set(found.aside) == set(test.broken)
    assert {row["run_name"] for row in found.reduced} == set(test.truth)
    flags = {flag.kind: flag for flag in found.quality.flags if flag.kind != "set aside"}
    drifting = flags["zero drift"].runs if "zero drift" in flags else ()  # none where those that drift are broken
    assert set(drifting) == set(test.drifted) - set(test.broken)
    assert flags["set-up change"].runs == (test.changed,)
    assert not {"stiffness", "damping"} & set(flags), flags  # the dynamics are those of the test


@pytest.mark.soak(first=0)
def test_a_few_runs_and_a_zero_that_changed(tmp_path, rng):
    test = simulated_test(
        tmp_path / "test", rng, angles=[6.0], polars=4, broken=1, drifted=1, change_at=2, calibration=False
    )
    found = reduce_runs(test.file, tmp_path / "out", engine=Engine(workers=0))
    judged(found, test)
    own = {name for row in found.rows for name in row if not OF_RESULTS.fullmatch(name)}
    assert own == {"file", "run", "polar", "alpha", "q"}  # of the table; the others cannot be called so there
    for row in found.reduced:  # within 6 standard uncertainties of 11 degrees of freedom: 1 in 10 000
        assert row["CL"] == pytest.approx(test.truth[row["run_name"]][0], abs=6 * row["u_CL"])
    good = found.reduced[-1]
    zero = tmp_path / "test" / good["zero_from"].split()[0].rpartition("/")[2]
    record = read(zero)
    moved = {name: dataclasses.replace(one, values=one.values + 1e-4) for name, one in record.channels.items()}
    write_recording(zero, dataclasses.replace(record, channels={**record.channels, "rNF": moved["rNF"]}))
    again = reduce_runs(test.file, tmp_path / "out", engine=Engine(workers=0))
    same_zero = [row["run_name"] for row in found.rows if row["zero_from"] == good["zero_from"]]
    assert list(again.done) == same_zero
    changed = next(row for row in again.rows if row["run_name"] == good["run_name"])
    assert changed["balance_NF_N"] != good["balance_NF_N"]


@pytest.mark.long
def test_four_hundred_runs(tmp_path, rng):
    angles = np.arange(-4.0, 16.0, 2.0).tolist()
    test = simulated_test(tmp_path / "test", rng, angles=angles, polars=40, broken=3, drifted=13, change_at=20)
    found = reduce_runs(test.file, tmp_path / "out", engine=Engine())
    judged(found, test)
    every = found.quality.pooled["all"]
    assert 0.8 < every.chi_square < 1.25
    assert 0.93 < np.mean(coverage(found.rows, test.truth)) < 0.97
