"""The command line: it parses, calls and prints; errors become exit codes.

0 done; 1 the data cannot carry the result; 2 wrong call or unreadable file; 130 interrupted. What takes time to
load is loaded by `main`, after the answer to Ctrl-C is settled.
"""

from __future__ import annotations

import os
import sys


def main(arguments: list[str] | None = None) -> int:
    """Run one command; return its exit code."""
    from aerobalance.app.cli import program

    return program.main(arguments)


def run() -> None:
    """Entry point of the command `aerobalance`."""
    from aerobalance.app.cli import interrupt

    interrupt.watch()
    from aerobalance.app.cli import loading  # nothing may take time before Ctrl-C is answered

    loading.begin()
    from aerobalance.recording.blas_threads import settings_of_process

    os.environ.update(settings_of_process(os.environ))  # before the libraries are loaded
    code = main()
    interrupt.leave()
    loading.end()
    sys.exit(code)
