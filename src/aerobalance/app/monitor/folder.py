"""The project folder: the only place that the page reads from and writes to."""

from __future__ import annotations

import re
import unicodedata
from pathlib import Path
from typing import Any, Final

RECORDINGS: Final = (".h5", ".hdf5", ".tdms", ".csv")
"""Endings of files that are listed as recordings."""

RESULTS: Final = ("-force.csv", "-force.h5")
"""Endings of results, which are not."""

MADE: Final = ("-identified.html", "-force.html", "-dynamics.json", "-force.csv", "-force.h5")
"""Endings of all files that are made of a recording, after its name."""

MOST: Final = 500
"""Recordings that are listed at most: the newest."""

LONGEST: Final = 200
"""Longest name of a record [bytes]; results have names that are longer."""

_NAME: Final = re.compile(r"[\w(][\w .,()+=°-]{0,98}[\w)]|\w")


def _plain(name: str) -> bool:
    """Whether a name is one for a file here: letters of any script, composed or not, and a few signs."""
    return _NAME.fullmatch(unicodedata.normalize("NFC", name)) is not None


class Folder:
    """Files by their names, below one folder.

    Parameters
    ----------
    path
        The folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path.resolve()

    def file(self, name: str) -> Path:
        """Return a file of the folder itself.

        Raises
        ------
        ValueError
            The name is not plain, or leads out of the folder.
        """
        if not _plain(name) or ".." in name:
            raise ValueError(
                f"{name[:80]!r} is no name for a file here: letters, digits, spaces and . , ( ) + = - _ ° are allowed"
            )
        path = self.path / name
        self.check(path)
        return path

    def check(self, path: Path) -> None:
        """Refuse a path that leads out of the folder, by links too.

        Raises
        ------
        ValueError
            It does.
        """
        try:
            inside = (self.path / path).resolve().is_relative_to(self.path)
        except (OSError, RuntimeError, ValueError):
            inside = False
        if not inside:
            raise ValueError(f"{str(path)[:200]} is not below the project folder {self.path.name}")

    def named(self, path: Path | str) -> Path:
        """Return a file that a set-up names, or that is named for a recording.

        Raises
        ------
        ValueError
            It is outside the folder, by links too.
        """
        self.check(Path(path))
        return self.path / path

    def recording(self, name: str) -> Path:
        """Return a recording that is there.

        Raises
        ------
        ValueError
            There is none of that name.
        """
        path = self.file(name)
        if path.suffix.lower() not in RECORDINGS or not path.is_file():
            raise ValueError(f"there is no recording {name[:80]!r} in the project folder")
        return path

    def new_recording(self, name: str) -> Path:
        """Return where to record to; ``.h5`` is added where it is missing.

        Raises
        ------
        ValueError
            The name is not plain, or is taken.
        """
        name = unicodedata.normalize("NFC", name.strip())
        if len(name.encode("utf-8", "replace")) > LONGEST:
            raise ValueError(f"the name is longer than {LONGEST} bytes; give a shorter one")
        wanted = name if name.lower().endswith((".h5", ".hdf5")) else f"{name}.h5"
        path = self.file(wanted)
        if path.exists():
            raise ValueError(f"{wanted} is there already; give another name")
        return path

    def recordings(self) -> list[dict[str, Any]]:
        """List recordings, the newest first: name, size [bytes], time of the last change [s]."""
        found: list[dict[str, Any]] = []
        for path in self.path.iterdir():
            if path.suffix.lower() not in RECORDINGS or path.name.endswith(RESULTS) or not _plain(path.name):
                continue
            try:
                self.check(path)
                status = path.stat()
            except (OSError, ValueError):
                continue
            if path.is_file():
                found.append({"name": path.name, "size": status.st_size, "changed": status.st_mtime})
        return sorted(found, key=lambda item: -float(item["changed"]))[:MOST]

    def with_results(self) -> list[dict[str, Any]]:
        """List recordings, with the files that were made of them and whether dynamics were identified from them."""
        listed = self.recordings()
        for item in listed:
            stem = Path(item["name"]).stem
            found = [name for ending in MADE if self._has(name := f"{stem}{ending}")]
            item["reports"] = [name for name in found if name.endswith(".html")]
            item["files"] = [name for name in found if not name.endswith(".html")]
            item["identified"] = f"{stem}-dynamics.json" in found
        return listed

    def _has(self, name: str) -> bool:
        """Whether a file is there, and is in the folder indeed."""
        try:
            return self.named(name).is_file()
        except ValueError:
            return False
