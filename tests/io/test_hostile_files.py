"""Files made to hurt: whatever a file claims, reading it stays within seconds and memory, and an error says why."""

import json
import os
import re
import subprocess
import sys
import warnings

import h5py
import numpy as np
import pytest

from aerobalance.acquisition.setup import load_setup
from aerobalance.io import read, write_recording
from aerobalance.io.hdf5_contents import contents
from aerobalance.io.hdf5_layout import BLOCK, BlockWriter, Provenance, StoredChannel
from aerobalance.recording.channel import Channel
from aerobalance.recording.errors import DataQualityWarning, ReadError
from aerobalance.recording.recording import Recording
from seeds import trials

CHANNELS = (StoredChannel("AF", "N"), StoredChannel("NF", "N"))

LONGEST, LARGEST = 5.0, 500e6
"""Processor time [s] and memory [bytes] that any one file may take."""

WATCHED = """
import json, resource, sys, time, warnings
import h5py, numpy, pandas, scipy
from aerobalance.acquisition.setup import load_setup
from aerobalance.io import read, template
from aerobalance.io.csv_file import read_table
from aerobalance.recording.errors import ReadError
warnings.simplefilter("ignore")
ways = {"read": read, "template": template, "table": read_table, "setup": load_setup}
for given in sys.argv[2:]:
    way, path = given.split("=", 1)
    start, before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # far beyond what is allowed, so that a test fails and the machine does not
    resource.setrlimit(resource.RLIMIT_CPU, (int(start) + 60, resource.RLIM_INFINITY))
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


def test_sizes_that_converted_hdf5_files_claim_are_not_believed(tmp_path) -> None:
    def one_chunk(file) -> None:
        del file["samples"]
        file.create_dataset("samples", (2000, 2), "<f8", chunks=(2000, 2))

    cases = {
        "checksums": (
            replaced("checksums", (10**9, 2), "<u4", chunks=(10**5, 2)),
            "checksums: must be 2 of each of 1",
        ),
        "short": (replaced("checksums", data=np.zeros((0, 2), "<u4")), "checksums: must be 2 of each of 1 blocks"),
        "chunk": (one_chunk, "samples: must have a chunk for every column"),
        "nothing": (replaced("samples", (2000, 2), "<f8", chunks=(2000, 1)), "has no two samples|cannot be read|HDF5"),
    }
    paths = {}
    for name, (change, _) in cases.items():
        paths[name] = tmp_path / f"{name}.h5"
        time, channels = np.arange(2000) / 1000.0, {one: Channel(one, np.ones(2000), "N") for one in ("AF", "NF")}
        write_recording(paths[name], Recording.from_columns(time, channels))
        with h5py.File(paths[name], "r+") as file:
            change(file)
    said = bounded(*(("read", path) for path in paths.values()))
    for name, (_, words) in cases.items():
        assert re.search(words, said[str(paths[name])]), said[str(paths[name])]


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
    refused, count = 0, trials(100, 300)
    for _ in range(count):
        damaged = bytearray(data)
        for at in rng.integers(0, min(len(data), 12_000), int(rng.integers(1, 6))):
            damaged[int(at)] = int(rng.integers(0, 256))
        path.write_bytes(damaged)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)
            try:
                read(path)
            except ReadError as problem:
                refused += 1
                assert str(path) in str(problem)
    assert refused > count / 3


def test_work_on_text_goes_with_its_size(tmp_path) -> None:
    def wide(n):
        cells = ",".join(f"c{i} [N]" for i in range(n))
        return f"time [s],{cells}\n" + "".join(f"{k / 1000},{','.join(['1'] * n)}\n" for k in range(3))

    rows = 'time [s],AF [N],note\n0.000,1.5,"open\n' + "".join(f"{k / 1000},2,x\n" for k in range(1, 700_000))
    texts = {
        "wide-4": (wide(60_000).replace(" [N]", ""), "has more than 10000 columns"),
        "wide-5": (wide(100_000), "line 1: is longer than 1048576 bytes"),
        "wide-6": (wide(1_000_000), "line 1: is longer than 1048576 bytes"),
        "quote": (rows, "line 2: opens a quotation mark and does not close it"),
        "quote-in-header": ('time [s],"AF [N]\n' + "0.0,1\n" * 1_300_000, "time must increase"),
        "late-line": ("time [s],AF [N]\n0.0,1\n" + "0.1," + "1" * 3_000_000 + "\n", "line 3: is longer than"),
        "blank": ("\n" * 4_000_000, "is empty"),
        "spaces": (" " * 8_000_000, "line 1: is longer than"),
    }
    paths = {}
    for name, (content, _) in texts.items():
        paths[name] = tmp_path / f"{name}.csv"
        paths[name].write_text(content)
    said = bounded(*(("read", path) for path in paths.values()))
    for name, (_, words) in texts.items():
        assert words in said[str(paths[name])], said[str(paths[name])]


def test_a_header_line_of_any_length_is_refused_at_once(tmp_path) -> None:
    path = tmp_path / "header.csv"
    with path.open("wb") as file:
        file.write(b"time [s],")
        for _ in range(200):
            file.write(b"AF [N]," * 150_000)
    names = {way: tmp_path / f"{way}.csv" for way in ("read", "template", "table")}  # the same file, by way
    for name in names.values():
        name.hardlink_to(path)
    for said in bounded(*names.items()).values():
        assert "line 1: is longer than 1048576 bytes, which no line of a table is" in said


def test_toml_that_takes_the_parser_minutes_is_refused(tmp_path) -> None:
    texts = {
        "dotted": ("a." * 100_000 + "b=1", "line 1: has a key of more than 50 parts"),
        "spaced": ("a . " * 100_000 + "b=1", "more than 50 parts"),
        "quoted": ('"a".' * 100_000 + "b=1", "more than 50 parts"),
        "table": (f"# set-up\n[{'a.' * 100_000}b]", "line 2: has a key of more than 50 parts"),
        "inline": ("x = {" + "a." * 100_000 + "b=1}", "more than 50 parts"),
        "nested": ("a=" + "[" * 100_000, "nested too deeply"),
        "nested-tables": ("a=" + "{b=" * 100_000, "nested too deeply"),
        "digits": ("a=" + "9" * 500_000, "thousands of digits"),
        "words": ("a" * 1_000_000, "is no TOML"),
        "quotes": ("a = '''" + "\"'" * 400_000, "is no TOML"),
        "tables": ("".join(f"[a{i}.b]\n" for i in range(trials(20_000, 90_000))), "a0: is not known"),
        "large": ("#" * 1_100_000, "is larger than 1 MB, which a test set-up is not"),
    }
    paths = {}
    for name, (content, _) in texts.items():
        paths[name] = tmp_path / f"{name}.toml"
        paths[name].write_text(content)
    said = bounded(*(("setup", path) for path in paths.values()))
    for name, (_, words) in texts.items():
        assert words in said[str(paths[name])], said[str(paths[name])]


TEXT = 'time [s],AF [N],"pitch [deg]"\n' + "".join(f'{k / 100:.2f},{k}.5,"-{k}e-1"\n' for k in range(40))
SET_UP = """
name = "x"
[source]
kind = "simulated"
rig = "vibration"
seed = 7
[record]
seconds = 2.0
block = 0.1
[channels.AF]
scale = -1.5
"""


@pytest.mark.parametrize(("name", "way", "content"), [("a.csv", read, TEXT), ("a.toml", load_setup, SET_UP)])
def test_mutated_text_raises_read_errors_only(tmp_path, name, way, content) -> None:
    data, path = content.encode(), tmp_path / name
    rng = np.random.default_rng(21)
    signs = np.frombuffer(b"\x00\n\r\t \",;.=[]{}#-+eE19\\'\xff\xc3\x1a", dtype=np.uint8)
    refused, count = 0, trials(200, 400)
    for _ in range(count):
        damaged = bytearray(data)
        for _ in range(int(rng.integers(1, 5))):
            at = int(rng.integers(0, len(damaged)))
            part = bytes(rng.choice(signs, int(rng.integers(0, 3))).tolist())
            damaged[at : at + int(rng.integers(0, 3))] = part
        path.write_bytes(damaged)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)
            try:
                way(path)
            except ReadError as problem:
                refused += 1
                assert str(path) in str(problem)
                assert "\n" not in str(problem)
    assert count / 4 < refused < count
