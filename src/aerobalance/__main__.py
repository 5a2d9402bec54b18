"""The command line as a module: ``python -m aerobalance`` is the command `aerobalance`."""

from aerobalance.app.cli import run

if __name__ == "__main__":
    run()
