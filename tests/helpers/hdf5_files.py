"""Recordings in HDF5 as a recorder writes them."""

import warnings

import numpy as np

from aerobalance.io import read
from aerobalance.io.hdf5_layout import BlockWriter, Provenance, StoredChannel
from aerobalance.recording.errors import DataQualityWarning

CHANNELS = (
    StoredChannel("AF", "kN", input="Dev1/ai0", sign=-1.0, scale=0.5, offset=3.0, noise=0.01, delay=2e-4),
    StoredChannel("pitch", "deg"),
    StoredChannel("ground_acceleration", "m/s^2", coupling="ac", corner=0.5, relative_uncertainty=0.01),
)


def readings(first, last):
    ticks = np.arange(first, last)
    return np.column_stack([np.sin(ticks * 0.1), ticks * 0.01, np.cos(ticks * 0.3)])


def make(path, spans, *, rows=64, rate=1000.0, channels=CHANNELS, finish=True):
    """A recording of the given spans of ticks."""
    writer = BlockWriter(path, channels, rate=rate, rows=rows, provenance=Provenance("test", "notes = 'x'\n"))
    for first, last in spans:
        for tick in range(first, last, rows):
            writer.append(tick, readings(tick, min(tick + rows, last)))
    if finish:
        writer.finish("done")
    return writer


def quietly(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        return read(path)
