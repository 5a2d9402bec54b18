"""What the rows of a test say together: each thing flagged where it is there, and nothing where all is as stated."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ndtr

from aerobalance.app.campaign.definition import Repeats
from aerobalance.app.campaign.quality import SETTINGS, quality_of
from seeds import trials


def rows(rng, *, angles=(0.0, 4.0, 8.0), polars=8, spread=1.0):
    """Rows of polars that are repeats of each other, with a zero each."""
    found = []
    for polar in range(polars):
        level = rng.normal(0, 0.1)
        for alpha in angles:
            number = len(found) + 1
            found.append(
                {
                    "run_name": f"run_{number}",
                    "place": number,
                    "status": "reduced",
                    "verdict": "fit for use",
                    "doubts": [],
                    "setup": 0,
                    "balance_file": "balance.json",
                    "dynamics_file": "dynamics.json",
                    "zero_from": f"zero_{polar}.h5",
                    "alpha_deg": alpha,
                    "CL": 0.1 * alpha + spread * rng.normal(0, 0.01),
                    "u_CL": 0.02,
                    "u_run_CL": 0.01,
                    "u_zero_CL": 0.0,
                    "u_tare_CL": 0.0,
                    "zero_NF_N": level,
                    "u_zero_NF_N": 0.1,
                    "zero_drift_NF_N": rng.normal(0, 0.1),
                    "k_change_NF": rng.normal(0, 0.01),
                    "u_k_change_NF": 0.01,
                }
            )
    return found


def flags(given):
    return {flag.kind: flag for flag in quality_of(given, Repeats()).flags}


def test_what_is_as_stated_is_not_flagged(rng):
    found = quality_of(rows(rng), Repeats())
    assert found.flags == ()
    # three angles of eight repeats: 21 degrees of freedom, whose chi-square over 21 has a deviation of sqrt(2 / 21)
    assert found.pooled["CL"].freedom == pytest.approx(21)
    assert abs(found.pooled["all"].chi_square - 1) < 5 * np.sqrt(2 / 21)
    assert [one.condition for one in found.repeats] == [{"alpha": a, "beta": None} for a in (0.0, 4.0, 8.0)]


def test_a_run_apart_a_moved_zero_a_softer_spring_and_a_change_of_balance_are_flagged(rng):
    given = rows(rng)
    given[7]["CL"] += 0.2  # seven deviations of a difference between runs with different balances, which most are
    for row in given[9:12]:
        row["zero_NF_N"] += 2.0  # twenty uncertainties
    for row in given:
        row["k_change_NF"] -= 0.03  # three of one record, fifteen of the mean of 24
    for row in given[12:]:
        row["balance_file"] = "other.json"
    found = flags(given)
    assert set(found) == {"outlier", "zero drift", "stiffness", "set-up change", "scatter"}
    assert found["outlier"].runs == ("run_8",)
    assert found["outlier"].text.startswith("run_8: CL is ")
    assert found["zero drift"].runs == ("run_10", "run_11", "run_12")
    assert found["zero drift"].text.startswith("zero_3.h5 (3 runs) apart from the others: NF +")
    assert "off that of dynamics.json in the mean of 24 runs" in found["stiffness"].text
    assert found["set-up change"].text == "from run_13 on: balance balance.json to other.json"


def test_a_change_that_all_runs_share_counts_beyond_what_a_true_uncertainty_allows(rng):
    """An error of b of it leaves Phi(1.96 - b) - Phi(-1.96 - b) of the truths in 95 % intervals: 93 % of them."""
    most = 1.9600 - brentq(lambda edge: ndtr(edge) - ndtr(edge - 2 * 1.9600) - 0.93, 1.0, 1.9)
    assert SETTINGS.of_one == pytest.approx(most, abs=0.005)
    given = rows(rng, polars=120)  # the mean of 360 runs has a nineteenth of the uncertainty of one
    change = {"below": most - 0.3, "above": most + 0.3}  # 5.7 standard uncertainties of the mean from what counts
    found = {}
    for name, shift in change.items():
        shifted = [row | {"k_change_NF": row["k_change_NF"] + 0.01 * shift} for row in given]
        found[name] = "stiffness" in flags(shifted)
    assert found == {"below": False, "above": True}


def test_repeats_that_scatter_otherwise_than_stated_are_flagged(rng):
    # three times as much: chi-square 9 per degree of freedom with a deviation of 9 x 0.31; 46.8 / 21 is said
    wide, narrow = flags(rows(rng, spread=3.0)), flags(rows(rng, spread=0.1))
    assert "something changes from run to run" in wide["scatter"].text
    assert "larger than it need be" in narrow["scatter"].text


def test_the_error_of_a_tare_is_common_to_the_runs_that_it_was_taken_off_only(rng):
    # four tares of six repeats each: of 24 runs 4 x 6^2 - 24 of 24^2 - 24 ordered pairs share theirs
    own, tare = 0.01, 0.05
    found = []
    for _ in range(200):
        given = rows(rng, angles=(4.0,), polars=24)
        for place, level in enumerate(rng.normal(0, tare, 4)):
            for row in given[6 * place : 6 * (place + 1)]:
                row |= {"CL": row["CL"] + level, "u_tare_CL": tare, "tare_from": f"tare_{place}.h5"}
        (one,) = quality_of(given, Repeats()).repeats
        found.append(one.scatter)
    other = 1 - (4 * 6**2 - 24) / (24**2 - 24)
    assert found[0].expected == pytest.approx(np.sqrt(own**2 + other * tare**2), rel=1e-9)
    # a mean square of 4 tares, with 3 degrees of freedom, scatters by sqrt(2 / 3); of 200 of them the mean
    measured = np.mean([one.deviation**2 for one in found]) / found[0].expected ** 2
    assert measured == pytest.approx(1, abs=4 * np.sqrt(2 / 3 / 200))


@pytest.mark.parametrize("shared", [0.0, 0.9, 1.0])
def test_all_results_together_lie_within_their_limits_as_often_as_said(rng, shared):
    """Lift and drag of 24 runs at three angles, whose errors are partly the same."""
    runs, count = 24, trials(150, 400)
    row = {"status": "reduced", "verdict": "fit for use", "setup": 0, "balance_file": "", "dynamics_file": ""}
    row |= {"zero_from": None, "u_run_CL": 0.01, "u_zero_CL": 0.0, "u_run_CD": 0.02, "u_zero_CD": 0.0}
    inside = 0
    for _ in range(count):
        lift, own = rng.normal(0, 0.01, (2, runs))
        drag = -2 * (shared * lift + np.sqrt(1 - shared**2) * own)
        given = [
            row | {"run_name": f"{place}", "place": place, "alpha_deg": place % 3, "CL": one, "CD": other}
            for place, (one, other) in enumerate(zip(lift, drag, strict=True))
        ]
        together = quality_of(given, Repeats()).pooled["all"]
        low, high = together.limits
        inside += low < together.chi_square < high
    # 95 %, to what chance does and to 1 % for a sum that is only nearly a chi-square; with 42 degrees of freedom it is
    # 84 % where all is shared
    assert inside / count == pytest.approx(0.95, abs=0.01 + 4 * np.sqrt(0.05 * 0.95 / count))


def test_runs_set_aside_are_named_and_take_no_part(rng):
    given = rows(rng)
    given[0] = {**given[0], "status": "set aside", "reason": "is empty"}
    given[1] |= {"verdict": "not usable", "doubts": ["AF, clipping: rests on its limit"], "CL": 99.0}
    found = quality_of(given, Repeats())
    assert [(flag.kind, flag.text) for flag in found.flags] == [
        ("set aside", "run_1: is empty"),
        ("not usable", "run_2: AF, clipping: rests on its limit"),
    ]
    assert found.pooled["CL"].freedom == pytest.approx(19)
