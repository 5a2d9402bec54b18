"""Write a file whole or not at all, and keep account of what the running command writes."""

from __future__ import annotations

import contextlib
import errno
import filecmp
import os
import secrets
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from aerobalance.io.locked_file import refuse_locked
from aerobalance.recording.errors import argument


@dataclass(slots=True)
class Writing:
    """A file under way.

    Attributes
    ----------
    target
        The file to write.
    beside
        Where its new content is until it is complete.
    placing
        Whether the new content is complete and takes its place now.
    """

    target: Path
    beside: Path
    placing: bool = False


@dataclass(slots=True)
class Outputs:
    """What the running command writes, and what it may put its results in the place of.

    There is one for the process, as a signal can come at any moment and has to be answered from it.

    Attributes
    ----------
    active
        Whether a command is running; nothing is kept account of otherwise.
    replace
        Whether every file that exists may be replaced; where not, only a result of the same kind.
    wanted
        Files that the command was asked for.
    written
        Files that are complete.
    replaced
        Those of them that existed before.
    unmarked
        Files whose kind cannot be told by their content: they are kept unless the new content is the same.
    under_way
        Files of which a part is written.
    """

    active: bool = False
    replace: bool = True
    wanted: list[Path] = field(default_factory=list)
    written: list[Path] = field(default_factory=list)
    replaced: list[Path] = field(default_factory=list)
    unmarked: set[Path] = field(default_factory=set)
    under_way: list[Writing] = field(default_factory=list)

    def begin(self, *, replace: bool) -> None:
        """Begin the account of a command."""
        self.active, self.replace = True, replace
        for kept in (self.wanted, self.written, self.replaced, self.unmarked):
            kept.clear()

    def end(self) -> None:
        """End it: what is written from now on is nobody's."""
        self.active, self.replace = False, True
        self.unmarked.clear()

    def note(self, target: Path, *, replaced: bool) -> None:
        """Note a file that is complete."""
        if self.active and target not in self.written:
            self.written.append(target)
            if replaced:
                self.replaced.append(target)

    def abandon(self) -> None:
        """Take away what is not complete, as the process ends at once."""
        for part in self.under_way:
            if part.placing and not part.beside.exists():
                self.note(part.target, replaced=False)
            else:
                with contextlib.suppress(OSError):
                    part.beside.unlink(missing_ok=True)

    def told(self) -> str:
        """Return what was written and what was not, of the files that the command was asked for."""
        done = [str(path) for path in self.written]
        lacking = [str(path) for path in self.wanted if path not in self.written]
        if not done:
            return "nothing was written"
        return f"{_named(done)} written" + (f", {_named(lacking)} not" if lacking else "")


def _named(names: Sequence[str]) -> str:
    """Files as the subject of a sentence."""
    return (
        f"{len(names)} files were"
        if len(names) > 4
        else f"{' and '.join(names)} {'was' if len(names) == 1 else 'were'}"
    )


OUTPUTS: Final = Outputs()
"""Files of the running command."""


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """Return a path to write beside a file; put what was written in the file's place at the end.

    The file keeps its old content until the new one is complete and on the disk; where the writing fails, nothing
    is left over.

    Parameters
    ----------
    path
        The file to write.

    Yields
    ------
    Path
        An empty file in the same folder, to be written.

    Raises
    ------
    ValueError
        The folder does not exist or cannot be written to, or `path` is a folder; or it is a file that must not be
        replaced, or is being recorded.
    """
    target = Path(path)
    try:
        if target.is_dir():
            raise ValueError(f"{target} is a folder; the name of a file is needed")
        if not target.parent.is_dir():
            raise ValueError(f"cannot write {target}: there is no folder {target.parent}")
    except OSError as error:
        raise ValueError(f"cannot write {target}: {reason_of(error)}") from None
    refuse_locked(target)
    beside = target.parent / f".{target.name[:40]}.{secrets.token_hex(6)}.part"
    writing = Writing(target, beside)
    OUTPUTS.under_way.append(writing)  # before the file is there, so that no interrupt can leave one
    try:
        os.close(os.open(beside, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600))
        yield beside
        with beside.open("rb+") as file:
            os.fsync(file.fileno())
        beside.chmod(_mode(target))
        refuse_locked(target)  # a record may have begun meanwhile
        _place(writing)
    except OSError as error:
        raise ValueError(f"cannot write {target}: {reason_of(error)}") from error
    finally:
        beside.unlink(missing_ok=True)
        OUTPUTS.under_way.remove(writing)


def _place(writing: Writing) -> None:
    """Put the new content in its place."""
    target = writing.target
    there = target.exists()
    if target in OUTPUTS.unmarked and there:
        if filecmp.cmp(writing.beside, target, shallow=False):
            OUTPUTS.note(target, replaced=True)  # nothing to do, and nothing is lost
            return
        raise ValueError(
            f"{target} exists and differs from what would be written, and may be more than a result that can be "
            f"calculated again; give another name, or {argument('replace', True)}"
        )
    writing.placing = True
    writing.beside.replace(target)
    OUTPUTS.note(target, replaced=there)


def reason_of(error: OSError) -> str:
    """Why the system refuses a file, for a message."""
    if error.errno == errno.ENAMETOOLONG:
        return "its name is too long (a name may have 255 bytes on most disks)"
    return error.strerror or str(error)


def _mode(target: Path) -> int:
    """Permissions of the file: those it had, or those a new file gets (a file beside it is private)."""
    if target.exists():
        return target.stat().st_mode & 0o777
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask
