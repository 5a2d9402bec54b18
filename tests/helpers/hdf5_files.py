"""Recordings in HDF5 as a recorder writes them."""

import struct
import warnings
import zlib

import h5py
import numpy as np

from aerobalance.io import read
from aerobalance.io.hdf5_layout import BlockWriter, Provenance, StoredChannel, checksum
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


def with_crc32_of_samples(path):
    """Change a converted recording to layout 4: the checksum of a column is the CRC-32 of its samples."""
    with h5py.File(path, "r+") as file:
        table, blocks, own = file["samples"][...], file["blocks"][...], file["checksums"][...]
        for number, block in enumerate(blocks):
            rows = slice(int(block["tick"]), int(block["tick"] + block["rows"]))
            own[number] = [zlib.crc32(np.ascontiguousarray(column).tobytes()) for column in table[rows].T]
            block["crc32"] = zlib.crc32(struct.pack("<qq", rows.start, block["rows"]) + own[number].tobytes())
        file["blocks"][...], file["checksums"][...] = blocks, own
        file.attrs["schema_version"] = 4


def in_blocks(path, *, version=3):
    """Change a converted recording to what it was before its channels were stored apart."""
    with h5py.File(path, "r+") as file:
        table, blocks = file["samples"][...], file["blocks"][...]
        for block in blocks:
            own = slice(int(block["tick"]), int(block["tick"] + block["rows"]))
            block["crc32"] = checksum(own.start, table[own])
        chunk = (file["samples"].chunks[0], table.shape[1])
        del file["samples"], file["checksums"]
        file.create_dataset("samples", data=table, chunks=chunk, maxshape=(None, chunk[1]), fillvalue=np.nan)
        file["blocks"][...] = blocks
        file.attrs["schema_version"] = version
