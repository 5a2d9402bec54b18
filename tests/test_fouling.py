"""Contacts in a contact circuit's channel: against a plain loop, for any cut of the samples."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from aerobalance.acquisition.fouling import Contact, ContactFinder


def by_loop(readings, hold):
    """Contacts sample by sample: first tick, and tick after the last closed one once it has stayed open."""
    found, since, last = [], None, 0
    for tick, reading in enumerate(readings):
        if reading >= 2.5:
            if since is None:
                since = tick
                found.append(Contact(tick, True))
            last = tick
        elif since is not None and tick - last >= hold:
            found.append(Contact(last + 1, False, last + 1 - since))
            since = None
    return found


@settings(deadline=None, max_examples=100)
@given(
    st.lists(st.sampled_from([0.0, 0.0, 0.0, 5.0, np.nan]), max_size=60),
    st.lists(st.integers(0, 60), max_size=6),
    st.integers(1, 6),
)
def test_any_cut_gives_the_contacts_of_a_plain_loop(readings, cuts, hold) -> None:
    values = np.array(readings, dtype=np.float64)
    edges = sorted({0, len(values), *(cut for cut in cuts if cut < len(values))})
    finder, found = ContactFinder(2.5, hold=hold), []
    for begin, end in pairwise(edges):
        found += finder.push(begin, values[begin:end])
    assert found == by_loop(values, hold)
    assert finder.touching == (len(found) % 2 == 1)


def test_a_gap_in_the_samples_ends_a_contact() -> None:
    finder = ContactFinder(2.5, hold=3)
    assert finder.push(0, np.array([0.0, 5.0])) == [Contact(1, True)]
    assert finder.push(50, np.array([5.0])) == [Contact(2, False, 1), Contact(50, True)]


def test_circuit_that_reads_low_when_closed() -> None:
    finder = ContactFinder(0.5, closed_above=False)
    assert finder.push(0, np.array([5.0, 0.1, 5.0])) == [Contact(1, True), Contact(2, False, 1)]
