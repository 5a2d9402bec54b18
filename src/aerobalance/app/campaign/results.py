"""The folder of a campaign's results: each is written by the process that worked it out, whole or not at all.

``runs/NAME.json`` is written last of what a run has, and holds the digest of all that its result hangs on: while that
is the same, there is nothing to do for the run.
"""

from __future__ import annotations

import json
import secrets
import shutil
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from aerobalance.app.campaign.holding import LOCK, held
from aerobalance.app.campaign.places import MissingLibraryError, exists, is_address, joined, store_of
from aerobalance.app.campaign.rows import Row, columns_of
from aerobalance.io.artefacts import json_text
from aerobalance.io.safe_write import OUTPUTS, reason_of

if TYPE_CHECKING:
    import pyarrow as pa
    import xarray as xr

MANIFEST: Final = "campaign.json"
SUMMARY: Final = "summary.parquet"
PAGE: Final = "summary.html"
HISTORIES: Final = "histories.zarr"
KIND: Final = "campaign"
RUN_KIND: Final = "campaign run"
ROOT_GROUP: Final = '{"zarr_format": 3, "node_type": "group", "attributes": {}}\n'
"""What makes the folder of histories a Zarr group whose members are those of the runs."""


@dataclass(frozen=True, slots=True)
class Results:
    """The folder of results.

    Attributes
    ----------
    out
        A path, or an address of a store.
    """

    out: str

    def place(self, *names: str) -> str:
        """Return the place of a file or a group."""
        return joined(self.out, "/".join(names))

    @contextmanager
    def held(self, *, replace: bool = False) -> Iterator[None]:
        """Make the folder, keep other calls out of it, and take away what an earlier one left half-written.

        Raises
        ------
        ValueError
            The folder holds something else, another call works in it, or it cannot be made.
        """
        if not is_address(self.out):
            self._make(Path(self.out), replace=replace)
        with held(self.out):
            self._tidy()
            yield

    def _make(self, folder: Path, *, replace: bool) -> None:
        if folder.exists() and not folder.is_dir():
            raise ValueError(f"{folder} is a file; the results of a campaign are a folder")
        others = folder.is_dir() and any(one.name != LOCK for one in folder.iterdir())
        if others and not (folder / MANIFEST).is_file() and not replace:
            raise ValueError(
                f"{folder} exists and is no campaign's folder of results; give another name, or an empty folder"
            )
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ValueError(f"cannot make the folder {folder}: {reason_of(error)}") from None

    def _tidy(self) -> None:
        if not is_address(self.out):
            folder = Path(self.out)
            for left in (*folder.glob(".*.part"), *folder.glob("*/.*.part")):
                shutil.rmtree(left) if left.is_dir() else left.unlink()
        if not exists(self.place(MANIFEST)):
            self.write_text(json_text({"kind": KIND, "finished": False}), MANIFEST)
        root = self.place(HISTORIES, "zarr.json")
        if not exists(root):
            self.write_text(ROOT_GROUP, HISTORIES, "zarr.json")

    def write_text(self, text: str, *names: str) -> None:
        """Write a text, whole or not at all."""
        with self.writing(*names) as beside:
            beside.write_text(text, encoding="utf-8")

    @contextmanager
    def writing(self, *names: str) -> Iterator[Path]:
        """Give a path to write a file or a folder at; what was written is put in its place at the end.

        Raises
        ------
        ValueError
            It cannot be written.
        """
        target = self.place(*names)
        try:
            if is_address(target):
                with TemporaryDirectory(prefix="aerobalance-") as folder:
                    beside = Path(folder) / names[-1]
                    yield beside
                    _put(beside, target)
                    _noted(beside, None)
                return
            place = Path(target)
            place.parent.mkdir(parents=True, exist_ok=True)
            beside = place.parent / f".{place.name[:80]}.{secrets.token_hex(6)}.part"
            try:
                yield beside
                if place.is_dir():
                    shutil.rmtree(place)
                beside.replace(place)
                _noted(beside, place)
            finally:
                with suppress(OSError):
                    shutil.rmtree(beside) if beside.is_dir() else beside.unlink(missing_ok=True)
        except OSError as error:
            raise ValueError(f"cannot write {target}: {reason_of(error)}") from error

    @property
    def manifest(self) -> str:
        """What the last call wrote for programs; empty where there is nothing."""
        try:
            return self._read(MANIFEST).decode("utf-8")
        except (OSError, ValueError):
            return ""

    def record(self, run: str, key: str, row: Mapping[str, Any], outputs: Sequence[str]) -> None:
        """Write what a run's result is; the last of what it has."""
        text = json_text({"kind": RUN_KIND, "key": key, "outputs": list(outputs), "row": dict(row)})
        self.write_text(text, "runs", f"{run}.json")

    def forget(self, run: str) -> None:
        """Take away what a run has, the record first, before it is written anew: not all of it may be."""
        self._remove("runs", f"{run}.json")
        self._remove("reports", f"{run}.html")
        self._remove(HISTORIES, run)

    def known(self, run: str, key: str) -> Row | None:
        """Return the row of a run that is done; None where there is none, or what it hangs on has changed."""
        found = self._record(run)
        if found is None or found.get("key") != key or not isinstance(found.get("row"), dict):
            return None
        if not all(exists(self.place(name)) for name in found.get("outputs", [])):
            return None
        return dict(found["row"])

    def _record(self, run: str) -> dict[str, Any] | None:
        try:
            text = self._read("runs", f"{run}.json")
            found = json.loads(text)
        except (OSError, ValueError):
            return None
        return found if isinstance(found, dict) and found.get("kind") == RUN_KIND else None

    def _read(self, *names: str) -> bytes:
        place = self.place(*names)
        if not is_address(place):
            return Path(place).read_bytes()
        system, inside = store_of(place)
        return bytes(system.cat_file(inside))

    def recorded(self) -> set[str]:
        """Return the names of the runs that have a record."""
        if not is_address(self.out):
            return {one.stem for one in Path(self.place("runs")).glob("*.json")}
        system, inside = store_of(self.place("runs"))
        return {Path(str(one)).stem for one in system.ls(inside, detail=False)} if system.exists(inside) else set()

    def keep_only(self, runs: Collection[str]) -> None:
        """Take away the results of runs that are no longer part of the test."""
        for run in sorted(self.recorded() - set(runs)):
            if self._record(run) is not None:
                self.forget(run)

    def _remove(self, *names: str) -> None:
        place = self.place(*names)
        if not is_address(place):
            path = Path(place)
            try:
                shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
            except OSError as error:
                raise ValueError(f"cannot take away {path}: {reason_of(error)}") from None
            return
        system, inside = store_of(place)
        if system.exists(inside):
            system.rm(inside, recursive=True)

    def write_table(self, rows: Sequence[Mapping[str, Any]], name: str) -> None:
        """Write rows as Parquet, a column for each key; what a row lacks is null."""
        import_needed()
        import pyarrow.parquet as pq  # noqa: PLC0415 - of an extra

        table = table_of(rows)
        with self.writing(name) as beside:
            pq.write_table(table, beside)

    def write_history(self, run: str, data: xr.Dataset) -> str:
        """Write time histories as a Zarr group of its own, and return where it is in the folder."""
        with self.writing(HISTORIES, run) as beside:
            data.to_zarr(beside, mode="w", zarr_format=3, consolidated=False)
        return f"{HISTORIES}/{run}"


def import_needed() -> None:
    """Make sure that the libraries that results are written with are installed.

    Raises
    ------
    MissingLibraryError
        One is not; the message names the command that installs it.
    """
    for library in ("pyarrow", "zarr", "xarray", "fsspec"):
        try:
            __import__(library)
        except ImportError:
            raise MissingLibraryError(library) from None


def _noted(beside: Path, place: Path | None) -> None:
    """Let the account of the running command name the file, and not what it was written as."""
    if beside in OUTPUTS.written:
        OUTPUTS.written.remove(beside)
        if place is not None:
            OUTPUTS.note(place, replaced=False)


def _put(beside: Path, target: str) -> None:
    """Copy a file or a folder to a store, in the place of what is there."""
    system, inside = store_of(target)
    if beside.is_dir():
        if system.exists(inside):
            system.rm(inside, recursive=True)
        files = (path for path in sorted(beside.rglob("*")) if path.is_file())
        # all at once, where the store can
        system.pipe({f"{inside}/{path.relative_to(beside).as_posix()}": path.read_bytes() for path in files})
        return
    system.pipe_file(inside, beside.read_bytes())


def table_of(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Return rows as a table: numbers, whole numbers, texts and lists of texts, by what the rows hold."""
    import pyarrow as pa  # noqa: PLC0415 - of an extra

    arrays = {}
    for name in columns_of(rows):
        cells = [row.get(name) for row in rows]
        given = [one for one in cells if one is not None]
        if any(isinstance(one, list) for one in given):
            arrays[name] = pa.array(cells, pa.list_(pa.string()))
        elif all(isinstance(one, bool) for one in given) and given:
            arrays[name] = pa.array(cells, pa.bool_())
        elif all(isinstance(one, int) and not isinstance(one, bool) for one in given) and given:
            arrays[name] = pa.array(cells, pa.int64())
        elif all(isinstance(one, int | float) and not isinstance(one, bool) for one in given):
            numbers = [None if one is None or not np.isfinite(one) else float(one) for one in cells]
            arrays[name] = pa.array(numbers, pa.float64())
        else:
            arrays[name] = pa.array([None if one is None else str(one) for one in cells], pa.string())
    return pa.table(arrays)
