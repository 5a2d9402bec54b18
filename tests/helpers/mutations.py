"""Files of any format damaged byte by byte, and read in a process of their own within limits."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

SECONDS = 5.0
"""Processor time that any one file may take."""

BYTES = 1e9
"""Memory that any one file may take."""

SIGNS = np.frombuffer(b'\x00\x01\x7f\x80\xff\n ",;.=[]{}-+eE19', dtype=np.uint8)

READER = """
import faulthandler, json, resource, sys, time, warnings
import h5py, numpy, pandas, scipy, scipy.io, scipy.io.wavfile
sys.path[:0] = json.loads(sys.argv[1])
from pathlib import Path
from helpers.mutations import damaged
from aerobalance.io import load_channel_map, read, template
from aerobalance.recording.errors import ReadError
warnings.simplefilter("ignore")
originals, folder, seed, first, count = json.loads(sys.argv[2]), Path(sys.argv[3]), *map(int, sys.argv[4:7])
chosen = load_channel_map(sys.argv[7]) if sys.argv[7] else None
for number in range(first, count * len(originals)):
    original = Path(originals[number // count])
    if number in (first, number // count * count):
        template(original), read(original, channel_map=chosen)  # libraries and their caches
    path = damaged(original, folder, numpy.random.default_rng([seed, number % count]))
    print(json.dumps([number]), flush=True)
    start, before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    resource.setrlimit(resource.RLIMIT_CPU, (int(start) + 30, resource.RLIM_INFINITY))
    faulthandler.dump_traceback_later(120, exit=True)  # what waits takes no processor time
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

    def take(self, name: str, said: list[str], spent: float, more: float) -> None:
        """Count what a copy was read to, and note what it must not be."""
        self.longest, self.most = max(self.longest, spent), max(self.most, more)
        if spent > SECONDS or more > BYTES:
            self.faults.append(f"{name}: {spent:.1f} s, {more / 1e6:.0f} MB: {said}")
        for text in said:
            if text.startswith("!") or len(text) > 1000 or (text != "read" and name.split(maxsplit=1)[0] not in text):
                self.faults.append(f"{name}: {text[:300]}")
        self.read += said[-1] == "read"
        self.refused += said[-1] != "read"
        self.words.append(said[-1])


def without_place(words: list[str]) -> list[str]:
    """Return the refusals of damaged files that do not say where in the file it is."""
    return [text for text in words if text != "read" and ": is a damaged" in text and text.count(": ") < 3]


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


def trial(originals: Sequence[Path], folder: Path, *, count: int, seed: int, channel_map: Path | str = "") -> Trial:
    """Read so many damaged copies of each file; a process that dies goes on behind the copy that killed it."""
    found = Trial()
    folder.mkdir(parents=True, exist_ok=True)
    env = os.environ | {"OMP_NUM_THREADS": "1"}
    first, last = 0, count * len(originals)
    while first < last:
        paths = json.dumps([path for path in sys.path if path])
        files = json.dumps([str(original) for original in originals])
        command = [sys.executable, "-c", READER, paths, files, str(folder), str(seed), str(first), str(count)]
        command.append(str(channel_map))
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=env)
        rows = [json.loads(line) if line.startswith("[") else line for line in done.stdout.splitlines()]
        begun = [row[0] for row in rows if isinstance(row, list)]
        for row in rows:
            if isinstance(row, str):
                found.faults.append(f"printed {row[:200]}")
            elif len(row) > 1:
                found.take(f"{originals[row[0] // count].name} {row[0] % count}", *row[1:])
        if done.returncode == 0:
            break
        at = max(begun, default=first)
        name = originals[at // count].name
        found.faults.append(f"{name} {at % count}: the process died ({done.returncode}): {done.stderr[-800:]}")
        if not begun:
            break
        first = at + 1
    return found
