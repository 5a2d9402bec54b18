"""``python -m aerobalance.app.cli`` is the command `aerobalance`."""

from aerobalance.app.cli import run

run()
