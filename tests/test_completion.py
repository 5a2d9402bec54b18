"""The shell completes commands and options, and leaves files to itself."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

COMMAND = Path(sys.executable).parent / "aerobalance"
BASH = """
source completion
complete -p aerobalance
for line in "aerobalance identi" "aerobalance identify fr" "aerobalance force --dyn" "aerobalance force ru"; do
  COMP_WORDS=($line)
  COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
  _aerobalance_completion aerobalance
  echo "${COMPREPLY[@]}"
done
"""


def answered(shell: str, script: str, folder: Path) -> list[str]:
    """Lines that a shell prints which has read the completion of the installed command."""
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not here")
    environment = {
        **os.environ,
        "PATH": f"{COMMAND.parent}{os.pathsep}{os.environ['PATH']}",
        "HOME": str(folder),
        # the shell is named and not looked for among the processes above this one
        "_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1",
    }
    asked = [str(COMMAND), "--show-completion", shell]
    shown = subprocess.run(asked, env=environment, capture_output=True, text=True, check=True).stdout
    (folder / "completion").write_text(shown)
    (folder / "run.csv").write_text("")
    done = subprocess.run(
        [shell, "-c", script], cwd=folder, env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()


def test_bash_completes_commands_options_and_files(tmp_path) -> None:
    said, *found = answered("bash", BASH, tmp_path)
    assert "-o default" in said  # what has no completion of its own is a file
    assert found == ["identify", "frf", "--dynamics", ""]


def test_fish_completes_commands_options_and_files(tmp_path) -> None:
    lines = {
        "aerobalance identi": "identify",
        "aerobalance force --dyn": "--dynamics",
        "aerobalance force ru": "run.csv",
    }
    script = "; ".join(["source completion", *(f"complete -C '{line}' | head -n 1" for line in lines)])
    found = answered("fish", script, tmp_path)
    assert [line.split("\t")[0] for line in found] == list(lines.values())
