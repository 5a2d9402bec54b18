"""Peaks that coupled dynamics do not explain: which are one, and what is said of them."""

from __future__ import annotations

import pytest

from aerobalance.dynamics.modal import Mode
from aerobalance.estimation.checks.peaks import Peak, peak_doubts

MODES = (Mode(100.0, 0.5, 0.01), Mode(160.0, 0.5, 0.01))


@pytest.mark.parametrize(
    ("frequency", "kind", "text"),
    [(102.0, "natural frequency", "not as the mode at 100 Hz"), (130.0, "missing mode", "no mode of the dynamics")],
)
def test_a_peak_beside_a_mode_is_that_mode_and_any_other_is_missing(frequency, kind, text):
    (doubt,) = peak_doubts([Peak("NF", frequency, 0.1)], MODES)
    assert doubt.kind == kind
    assert text in doubt.text
    assert doubt.unit == "N"
    # a bridge that is 1 ms late leaves such a peak, at the frequency of the mode
    assert ("late against the others" in doubt.text) == (kind == "natural frequency")


def test_peaks_of_several_components_at_one_frequency_are_told_once_by_the_surest():
    peaks = [Peak("NF", 131.0, 1.0), Peak("PM", 130.0, 0.1), Peak("AF", 220.0, 0.5)]
    first, second = peak_doubts(peaks, MODES)
    assert (first.component, second.component) == ("PM", "AF")
    assert "NF, PM ring at 130 Hz (u = 0.1 Hz)" in first.text
    assert first.unit == "N*m"
    assert peak_doubts([], MODES) == []


def test_without_modes_every_peak_is_a_missing_one():
    (doubt,) = peak_doubts([Peak("NF", 100.0, 0.1)], ())
    assert doubt.kind == "missing mode"
