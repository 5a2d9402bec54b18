"""``python -m aerobalance.cli`` is the command `aerobalance`."""

from aerobalance.cli import run

run()
