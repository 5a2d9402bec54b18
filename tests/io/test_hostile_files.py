"""Files made to hurt: whatever a file claims, reading it stays within seconds and memory, and an error says why."""

import json
import os
import subprocess
import sys
import warnings

import h5py
import numpy as np
import pytest

from aerobalance.io import read
from aerobalance.io.hdf5_contents import contents
from aerobalance.io.hdf5_layout import BLOCK, BlockWriter, Provenance, StoredChannel
from aerobalance.problems import DoubtWarning, ReadError

CHANNELS = (StoredChannel("AF", "N"), StoredChannel("NF", "N"))

LONGEST, LARGEST = 5.0, 500e6
"""Processor time [s] and memory [bytes] that any one file may take."""

WATCHED = """
import json, resource, sys, time, warnings
import h5py, numpy, pandas, scipy
from aerobalance.acquire.setup import load_setup
from aerobalance.io import read, template
from aerobalance.io.csv_file import read_table
from aerobalance.problems import ReadError
warnings.simplefilter("ignore")
ways = {"read": read, "template": template, "table": read_table, "setup": load_setup}
for given in sys.argv[2:]:
    way, path = given.split("=", 1)
    start, before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # far beyond what is allowed, so that a test fails and the machine does not
    resource.setrlimit(resource.RLIMIT_CPU, (int(start) + 60, int(start) + 61))
    try:
        ways[way](path)
        said = "read"
    except ReadError as error:
        said = str(error)
    except BaseException as error:
        said = f"{type(error).__name__}: {error}"
    spent = time.process_time() - start
    more = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    print(json.dumps([path, said, spent, more]), flush=True)
"""


def watched(*given):
    """What reading each file by a way came to: text of the error or ``read``, processor time [s], more memory [bytes].

    One process reads them all, smallest demand first, as its memory is measured by its largest so far.
    """
    command = [sys.executable, "-c", WATCHED, "", *(f"{way}={path}" for way, path in given)]
    env = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=env)
    found = {}
    for line in done.stdout.splitlines():
        path, *rest = json.loads(line)
        found[path] = rest
    assert len(found) == len(given), f"stopped after {list(found)}: {done.stderr[-2000:]}"
    return found


def bounded(*given):
    """Check that each file is refused within the bounds; return the words by file."""
    found = watched(*given)
    for path, (said, spent, more) in found.items():
        assert spent < LONGEST, f"{path}: {spent:.1f} s"
        assert more < LARGEST, f"{path}: {more / 1e6:.0f} MB"
        assert path in said, f"{path}: {said[:300]}"
        assert len(said) < 1000
    return {path: said for path, (said, _, _) in found.items()}


def recording(path, n=2000):
    writer = BlockWriter(path, CHANNELS, rate=1000.0, rows=500, provenance=Provenance("test"))
    for tick in range(0, n, 500):
        ticks = np.arange(tick, tick + 500)
        writer.append(tick, np.column_stack([np.sin(ticks * 0.1), np.cos(ticks * 0.1)]))
    writer.finish("done")
    return path


def changed(folder, name, change):
    """A recording with something else in place of one of its datasets."""
    path = recording(folder / f"{name}.h5")
    with h5py.File(path, "r+") as file:
        change(file)
    return path


def replaced(dataset, *args, **settings):
    def change(file):
        del file[dataset]
        file.create_dataset(dataset, *args, **settings)

    return change


def one_block(rows):
    def change(file):
        file["blocks"].resize((1,))
        file["blocks"][0] = np.array((0, rows, 0, 0.0), BLOCK)

    return change


def packed_samples(file):
    """2 MB of gzip that is 2 GB of samples, and a table of blocks that is happy with it."""
    del file["samples"]
    file.create_dataset("samples", (10**8, 2), "<f8", chunks=(10**7, 2), compression="gzip", fillvalue=0.0)
    file["samples"][:10] = 1.0
    one_block(60_000)(file)


def huge_piece(file):
    """One piece of 1.6 GB, of which nothing is there."""
    del file["samples"]
    file.create_dataset("samples", (10**8, 2), "<f8", chunks=(10**8, 2))
    one_block(1000)(file)


def many_attributes(file):
    file.attrs["schema_version"] = np.full(7000, 3)


def test_sizes_that_hdf5_files_claim_are_not_believed(tmp_path) -> None:
    packed = {"chunks": True, "compression": "gzip"}
    cases = {
        "blocks": (replaced("blocks", (10**9,), BLOCK, chunks=(10**5,)), "claims pieces of 2800000 bytes"),
        "rows-of-blocks": (replaced("blocks", (10**9,), BLOCK, chunks=(100,)), "claims 1000000000 rows"),
        "gaps": (replaced("gaps", data=np.zeros(10**5, "<i8")), "no table"),
        "packed-blocks": (replaced("blocks", data=np.zeros(10**6, BLOCK), **packed), "compressed"),
        "packed": (packed_samples, "compressed"),
        "piece": (huge_piece, "claims pieces of 1600000000 bytes"),
        "attribute": (many_attributes, "attribute schema_version: must be one number"),
        "rows": (one_block(500_000), "impossible number of rows"),
    }
    paths = {name: changed(tmp_path, name, change) for name, (change, _) in cases.items()}
    said = bounded(*(("read", path) for path in paths.values()))
    for name, (_, words) in cases.items():
        assert words in said[str(paths[name])], said[str(paths[name])]


def test_a_set_up_of_any_size_is_passed_over(tmp_path) -> None:
    vast = changed(tmp_path, "vast", replaced("setup", (10**10,), "u1", chunks=(10**6,)))
    packed = changed(tmp_path, "packed", replaced("setup", (10**9,), "u1", chunks=(10**6,), compression="gzip"))
    for said, spent, more in watched(("read", vast), ("read", packed)).values():
        assert said == "read"
        assert spent < LONGEST
        assert more < LARGEST


def external(name, target):
    def change(file):
        if name in file:
            del file[name]
        file[name] = h5py.ExternalLink(str(target), name)

    return change


def foreign_bytes(target):
    return replaced("status", (1,), BLOCK, external=[(str(target), 0, h5py.h5f.UNLIMITED)])


def virtual(target):
    def change(file):
        del file["samples"]
        layout = h5py.VirtualLayout((2000, 2), "<f8")
        layout[...] = h5py.VirtualSource(str(target), "samples", (2000, 2))
        file.create_virtual_dataset("samples", layout)

    return change


def soft(file):
    file.move("samples", "elsewhere")
    file["samples"] = h5py.SoftLink("/elsewhere")


def test_data_outside_the_file_are_not_read(tmp_path) -> None:
    other = recording(tmp_path / "other.h5")
    cases = {
        "external-link": (external("samples", other), "samples: is a link to another file; links are not followed"),
        "soft-link": (soft, "samples: is a link to elsewhere"),
        "external-time": (external("time", other), "time: is a link to another file"),
        "external-storage": (foreign_bytes(other), "status: takes its data from other files"),
        "virtual": (virtual(other), "samples: takes its data from other files"),
    }
    for name, (change, words) in cases.items():
        path = changed(tmp_path, name, change)
        for way in (read, contents):
            with pytest.raises(ReadError) as problem:
                way(path)
            assert words in str(problem.value)


def test_the_file_that_a_link_names_is_not_even_opened(tmp_path) -> None:
    pipe = tmp_path / "pipe.h5"
    os.mkfifo(pipe)  # whoever opened it would wait for ever
    path = changed(tmp_path, "link", external("time", pipe))
    said = bounded(("read", path))
    assert "link to another file" in said[str(path)]


def test_damaged_hdf5_raises_read_errors_only(tmp_path) -> None:
    path = recording(tmp_path / "a.h5")
    data = path.read_bytes()
    rng = np.random.default_rng(20)
    refused = 0
    for _ in range(300):
        damaged = bytearray(data)
        for at in rng.integers(0, min(len(data), 12_000), int(rng.integers(1, 6))):
            damaged[int(at)] = int(rng.integers(0, 256))
        path.write_bytes(damaged)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DoubtWarning)
            try:
                read(path)
            except ReadError as problem:
                refused += 1
                assert str(path) in str(problem)
    assert refused > 100
