"""Files of any format damaged byte by byte, and read in a process of their own within limits."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

SECONDS = 5.0
"""Processor time that any one file may take."""

BYTES = 1e9
"""Memory that any one file may take."""

SIGNS = np.frombuffer(b'\x00\x01\x7f\x80\xff\n ",;.=[]{}-+eE19', dtype=np.uint8)

READER = """
import json, resource, sys, time, warnings
import h5py, numpy, pandas, scipy, scipy.io, scipy.io.wavfile
sys.path[:0] = json.loads(sys.argv[1])
from pathlib import Path
from helpers.mutations import damaged
from aerobalance.io import load_channel_map, read, template
from aerobalance.recording.errors import ReadError
warnings.simplefilter("ignore")
original, folder, seed, first, last = Path(sys.argv[2]), Path(sys.argv[3]), *map(int, sys.argv[4:7])
chosen = load_channel_map(sys.argv[7]) if sys.argv[7] else None
template(original), read(original, channel_map=chosen)  # libraries and their caches
for number in range(first, last):
    path = damaged(original, folder, numpy.random.default_rng([seed, number]))
    print(json.dumps([number]), flush=True)
    start, before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    resource.setrlimit(resource.RLIMIT_CPU, (int(start) + 30, resource.RLIM_INFINITY))
    said = []
    for way in (template, lambda path: read(path, channel_map=chosen)):
        try:
            way(path)
            said.append("read")
        except ReadError as error:
            said.append(str(error))
        except BaseException as error:
            said.append(f"!{type(error).__name__}: {error}")
    spent = time.process_time() - start
    more = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    print(json.dumps([number, said, spent, more]), flush=True)
"""


@dataclass
class Trial:
    """What became of the damaged copies of one file."""

    read: int = 0
    refused: int = 0
    longest: float = 0.0
    most: float = 0.0
    faults: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)


def damaged(original: Path, folder: Path, rng: np.random.Generator) -> Path:
    """Write a copy of a file with some bytes changed, cut out or put in; of a folder, one of its files."""
    path = folder / original.name
    if original.is_dir():
        shutil.rmtree(path, ignore_errors=True)
        shutil.copytree(original, path)
        files = sorted(file for file in path.rglob("*") if file.is_file())
        marks = [file for file in files if file.suffix == ".json" or file.name.startswith(".z")]
        chosen = marks if marks and rng.random() < 0.7 else files
        target = chosen[int(rng.integers(len(chosen)))]
        target.write_bytes(mutated(target.read_bytes(), rng))
    else:
        path.write_bytes(mutated(original.read_bytes(), rng))
    return path


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """Change a few bytes, mostly near either end, where formats say what they hold; sometimes cut or insert."""
    found = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        size = len(found)
        if not size:
            break
        near = int(rng.integers(0, min(size, 4096)))
        at = (near, size - 1 - near, int(rng.integers(0, size)))[int(rng.choice(3, p=[0.5, 0.3, 0.2]))]
        way = rng.random()
        if way < 0.6:
            found[at] = int(rng.integers(0, 256))
        elif way < 0.8:
            part = bytes(rng.choice(SIGNS, int(rng.integers(1, 9))).tolist())
            found[at : at + len(part)] = part
        elif way < 0.87:
            found[at] ^= 1 << int(rng.integers(0, 8))
        elif way < 0.92:
            del found[at : at + int(rng.integers(1, 9))]
        elif way < 0.97:
            found[at:at] = bytes(rng.choice(SIGNS, int(rng.integers(1, 9))).tolist())
        else:
            del found[at:]
    return bytes(found)


def trial(original: Path, folder: Path, *, count: int, seed: int, channel_map: Path | str = "") -> Trial:
    """Read so many damaged copies of a file; a process that dies goes on behind the copy that killed it."""
    found = Trial()
    folder.mkdir(parents=True, exist_ok=True)
    env = os.environ | {"OMP_NUM_THREADS": "1"}
    first = 0
    while first < count:
        paths = json.dumps([path for path in sys.path if path])
        command = [sys.executable, "-c", READER, paths, str(original), str(folder), str(seed), str(first), str(count)]
        command.append(str(channel_map))
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=env)
        last = first - 1
        for line in done.stdout.splitlines():
            if not line.startswith("["):
                found.faults.append(f"{first}: printed {line[:200]}")
                continue
            row = json.loads(line)
            last = row[0]
            if len(row) == 1:
                continue
            number, said, spent, more = row
            found.longest, found.most = max(found.longest, spent), max(found.most, more)
            if spent > SECONDS or more > BYTES:
                found.faults.append(f"{number}: {spent:.1f} s, {more / 1e6:.0f} MB: {said}")
            for text in said:
                if text.startswith("!") or len(text) > 1000 or (text != "read" and original.name not in text):
                    found.faults.append(f"{number}: {text[:300]}")
            found.read += said[-1] == "read"
            found.refused += said[-1] != "read"
            found.words.append(said[-1])
        if last < first or done.returncode == 0:
            if done.returncode:
                found.faults.append(f"{first}: ended with {done.returncode}: {done.stderr[-500:]}")
            break
        found.faults.append(f"{last}: the process died ({done.returncode}): {done.stderr[-300:]}")
        first = last + 1
    return found
