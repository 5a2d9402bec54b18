"""HDF5 files on a disk that fills, after a kill, and in other programs' hands."""

import os
import resource
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from aerobalance.io import read, write_recording
from aerobalance.io.hdf5_closing import close_all_broken_off, close_broken_off, lookup3
from aerobalance.io.hdf5_guard import GuardedFile
from aerobalance.recording.errors import DataQualityWarning
from helpers.hdf5_files import make, quietly, readings

WRITES = """
import resource, sys
from aerobalance.app.cli import run
if sys.argv[1] != "0":
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]),) * 2)
sys.argv = ["aerobalance", *sys.argv[2:]]
run()
"""


def program(*arguments, largest=0):
    """Run the program with a limit on the size of a file [bytes]."""
    command = [sys.executable, "-c", WRITES, str(largest), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def check_refused(done, folder, before):
    """A message and exit 2; nothing of the library's, nothing left."""
    assert done.returncode == 2, done.stderr
    assert "used up" in done.stderr
    assert "Traceback" not in done.stderr
    assert "h5py" not in done.stderr
    assert set(folder.iterdir()) == before


def long_text(path, n=60_000):
    rows = "\n".join(f"{i / 1000:.3f},{np.sin(i * 0.1):.9f},{np.cos(i * 0.1):.9f}" for i in range(n))
    path.write_text(f"time [s],AF [N],pitch [deg]\n{rows}\n")
    return path


EVERY_SIZE = """
import os, resource, sys
from pathlib import Path
from aerobalance.io import read, write_recording
folder = Path(sys.argv[1])
recording = read(folder / "a.csv")
write_recording(folder / "whole.h5", recording)
whole = (folder / "whole.h5").stat().st_size
for largest in (1, 100, 4096, 30_000, 700_000, whole - 3000, whole - 1):
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest, resource.RLIM_INFINITY))
    try:
        write_recording(folder / "b.h5", recording)
    except ValueError as error:
        assert "used up" in str(error), error
    else:
        raise SystemExit(f"written in spite of a limit of {largest}")
    assert len(os.listdir(folder)) == 2, os.listdir(folder)
resource.setrlimit(resource.RLIMIT_FSIZE, (whole, resource.RLIM_INFINITY))
write_recording(folder / "b.h5", recording)
assert (read(folder / "b.h5").channel("AF").values == recording.channel("AF").values).all()
sys.stdout.write("through")
"""


def test_hdf5_that_finds_no_room_is_refused_at_any_size_and_nothing_is_left(tmp_path) -> None:
    long_text(tmp_path / "a.csv")
    command = [sys.executable, "-c", EVERY_SIZE, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "through", "")


def test_hdf5_on_a_full_file_system_is_refused_and_nothing_is_left(tmp_path) -> None:
    small = tmp_path / "small"
    small.mkdir()
    mount = shutil.which("mount")
    if os.geteuid() != 0 or mount is None:
        pytest.skip("a small file system can only be mounted by root")
    if subprocess.run([mount, "-t", "tmpfs", "-o", "size=1m", "tmpfs", small], check=False).returncode:
        pytest.skip("mounting is not allowed here")
    try:
        source = long_text(tmp_path / "a.csv")
        done = program("convert", source, "-o", small / "b.h5")
        check_refused(done, small, set())
    finally:
        subprocess.run(["umount", small], check=True)


def test_what_the_disk_refuses_is_read_back_until_the_file_is_closed(tmp_path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    rng = np.random.default_rng(4)
    truth = bytearray(60_000)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        with pytest.raises(OSError, match="File too large"), GuardedFile(tmp_path / "a") as disk:
            for _ in range(200):
                place, part = int(rng.integers(0, 55_000)), rng.bytes(int(rng.integers(1, 5000)))
                disk.seek(place)
                assert disk.write(part) == len(part)
                truth[place : place + len(part)] = part
                disk.seek(0)
                held = disk.read()
                assert held == bytes(truth[: len(held)])
            assert disk.failure is not None
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_recorder_that_finds_no_room_at_all_leaves_nothing(tmp_path) -> None:
    done = program("record", "--source", "simulated", "--seconds", "1", "-o", tmp_path / "a.h5", largest=1000)
    assert done.returncode in (1, 2)
    assert "Traceback" not in done.stderr
    assert "cannot record to" in done.stderr
    assert not list(tmp_path.iterdir())


KILLED = """
import os, sys, signal
sys.path[:0] = {folders!r}
from pathlib import Path
from helpers.hdf5_files import make
writers = [make(Path(file), [(0, n)], finish=False) for file, n in {files!r}.items()]
os.kill(os.getpid(), signal.SIGKILL)
"""


def killed(path, n=300):
    """A file whose writer was killed."""
    return killed_with({path: n})[0]


def killed_with(sizes):
    """Files of so many samples each, whose one writer was killed."""
    files = {str(path): n for path, n in sizes.items()}
    code = KILLED.format(folders=[str(Path(__file__).parents[1])], files=files)
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -signal.SIGKILL
    for path in sizes:
        with pytest.raises(OSError, match="already open for write"):
            h5py.File(path)
    return list(sizes)


def test_after_a_kill_the_file_is_closed_and_other_programs_open_it(tmp_path) -> None:
    sizes = (64, 300, 3001)
    files = killed_with({tmp_path / f"{n}.h5": n for n in sizes})
    for n, file in zip(sizes, files, strict=True):
        with pytest.warns(DataQualityWarning, match="Other HDF5 programs refuse it until it is closed"):
            read(file)
        marked = file.read_bytes()
        assert close_broken_off(file)
        with h5py.File(file) as opened:
            assert np.array_equal(opened["samples"][...], readings(0, n))
            assert opened["blocks"][-1]["rows"] == (n - 1) % 64 + 1
        assert not close_broken_off(file)
        assert quietly(file).samples == n
        if shutil.which("h5clear"):  # the HDF5 group's own tool, where it is installed
            again = tmp_path / "again.h5"
            again.write_bytes(marked)
            subprocess.run(["h5clear", "-s", "-i", "0", again], check=True)
            assert again.read_bytes() == file.read_bytes()


def test_hdf5_of_1_10_and_later_reads_what_is_written(tmp_path) -> None:
    if shutil.which("h5dump") is None:
        pytest.skip("h5dump (hdf5-tools) is not installed")
    make(tmp_path / "recorded.h5", [(0, 300)])
    write_recording(tmp_path / "converted.h5", read(tmp_path / "recorded.h5"))
    write_recording(tmp_path / "converted.nc", read(tmp_path / "recorded.h5"))
    for name in ("recorded.h5", "converted.h5", "converted.nc"):
        subprocess.run(["h5dump", tmp_path / name], stdout=subprocess.DEVNULL, check=True)


def test_a_file_in_progress_is_never_touched(tmp_path) -> None:
    writer = make(tmp_path / "a.h5", [(0, 128)], finish=False)
    before = (tmp_path / "a.h5").read_bytes()
    assert not close_broken_off(tmp_path / "a.h5")
    assert close_all_broken_off(tmp_path) == []
    assert (tmp_path / "a.h5").read_bytes() == before
    writer.append(128, readings(128, 190))
    writer.finish("done")
    assert quietly(tmp_path / "a.h5").samples == 190
    assert not close_broken_off(tmp_path / "a.h5")


def test_closing_takes_only_recordings_in_the_folder_itself(tmp_path) -> None:
    outside, folder = tmp_path / "outside", tmp_path / "folder"
    outside.mkdir()
    folder.mkdir()
    file = killed(outside / "a.h5")
    (folder / "link.h5").symlink_to(file)
    os.mkfifo(folder / "pipe.h5")
    (folder / "sub.h5").mkdir()
    (folder / "empty.h5").write_bytes(b"")
    (folder / "text.h5").write_text("time [s],AF [N]\n")
    damaged = bytearray(file.read_bytes())
    damaged[20] ^= 1  # the first bytes do not agree with their checksum
    (folder / "damaged.h5").write_bytes(damaged)
    good = folder / "good.H5"
    good.write_bytes(file.read_bytes())
    before = file.read_bytes()
    assert close_all_broken_off(folder) == ["good.H5"]
    assert file.read_bytes() == before
    assert (folder / "damaged.h5").read_bytes() == damaged
    assert close_all_broken_off(tmp_path / "nowhere") == []


def test_checksum_of_hdf5_structures() -> None:
    # Values of the reference implementation's own self-test, for initial value 0.
    assert lookup3(b"") == 0xDEADBEEF
    assert lookup3(b"Four score and seven years ago") == 0x17770551


def test_the_next_record_in_the_folder_closes_what_was_broken_off(tmp_path) -> None:
    file = killed(tmp_path / "old.h5")
    done = program("record", "--source", "simulated", "--seconds", "0.5", "-o", tmp_path / "new.h5")
    assert done.returncode == 0, done.stderr
    assert "old.h5 was broken off by a kill; it is closed now" in done.stderr
    for path in (file, tmp_path / "new.h5"):
        with h5py.File(path) as opened:
            assert opened["samples"].shape[0] > 0


def test_a_recording_is_written_whole_whatever_its_length(tmp_path) -> None:
    for n in (2, 8191, 8192, 8193, 20_000):
        stamps = np.arange(n) / 1000
        original = quietly(long_text(tmp_path / "a.csv", n))
        write_recording(tmp_path / "a.h5", original)
        again = read(tmp_path / "a.h5")
        assert np.array_equal(again.stamps, stamps)
        assert np.array_equal(again.channel("AF").values, original.channel("AF").values)


def test_a_damaged_file_with_the_mark_of_a_writer_is_not_waited_for(tmp_path) -> None:
    """The library waits without end for what does not agree with its checksum in a file that is being written."""
    file = killed(tmp_path / "killed.h5")
    content = file.read_bytes()
    for name, place in (("head", 20), ("root", content.index(b"OHDR") + 30), ("blocks", content.rindex(b"OHDR") + 30)):
        (tmp_path / f"{name}.h5").write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
    closed = bytearray(content)
    closed[11] = 0xAC  # of a closed file, a damaged flag
    (tmp_path / "flag.h5").write_bytes(closed)
    code = (
        "import sys; from aerobalance.io import read\n"
        "for path in sys.argv[1:]:\n    try: print(read(path).samples)\n    except Exception as error: print(error)"
    )
    paths = [str(tmp_path / f"{name}.h5") for name in ("head", "root", "blocks", "flag", "killed")]
    command = [sys.executable, "-W", "ignore", "-c", code, *paths]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    *refused, samples = done.stdout.splitlines()
    assert samples == "300"
    assert len(refused) == 4
    for path, line in zip(paths, refused, strict=False):
        assert line.startswith(f"{path}: ")
        assert "damaged" in line
