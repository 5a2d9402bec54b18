"""The stepped-sine run: the rig is driven at one frequency after the other, recorded, and identified."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Collection
from typing import Any, Final

from aerobalance.app.monitor.live_source import LiveSource
from aerobalance.app.monitor.log import Log
from aerobalance.app.monitor.records import Records
from aerobalance.app.monitor.tasks import Tasks
from aerobalance.recording.errors import FitError

SHARES: Final = (
    0.15,
    0.3,
    0.45,
    0.6,
    0.7,
    0.78,
    0.85,
    0.9,
    0.94,
    0.97,
    1.0,
    1.03,
    1.06,
    1.1,
    1.15,
    1.22,
    1.3,
    1.4,
    1.5,
)
"""Frequencies of the drive over the natural frequency that the dynamics have so far."""

DWELL: Final = 0.6
"""Time at each frequency [s]."""


class SteppedSineRun:
    """One run; its record begins with it.

    Parameters
    ----------
    source
        The rig that is driven.
    records
        Where the run is recorded.
    tasks
        Where it is identified.
    log
        What the operator is told.
    taken
        Names of recordings that are there already.

    Raises
    ------
    FitError, ValueError
        The source has no drive or no dynamics with a mass, or cannot be recorded.
    """

    def __init__(
        self, source: LiveSource, records: Records, tasks: Tasks, log: Log, *, taken: Collection[str]
    ) -> None:
        if "frequency" not in source.controls:
            raise ValueError("this source has no drive whose frequency can be set")
        watching = source.watching
        if watching is None or not watching.components:
            raise ValueError("the stepped-sine run needs dynamics, to know where the resonance is about")
        self._source, self._records, self._tasks, self._log = source, records, tasks, log
        self._component = watching.components[0]
        self._natural = watching.frequencies[self._component]
        mass = watching.masses.get(self._component)
        if mass is None:
            raise ValueError(
                f"the stepped-sine run needs the moving mass along {self._component}, which the dynamics do not have "
                "by itself; record the run by hand, and identify it with the mass"
            )
        self._mass = mass
        self._before = source.controls["frequency"]
        self._name = next(
            name for number in range(1, 10_000) if (name := f"stepped-sine-{number:03d}.h5") not in taken
        )
        records.begin(self._name, notes="stepped-sine run", seconds=None)
        self.shown: dict[str, Any] = {"text": f"recording {self._name}", "running": True}

    def start(self) -> None:
        """Drive the rig, in a thread of its own."""
        self._log.changed()
        threading.Thread(target=self._run, daemon=True).start()

    def _tell(self, text: str, **more: Any) -> None:
        self.shown = {"text": text, "running": False, **more}
        self._log.changed()

    def _drive(self) -> None:
        """Drive the rig at one frequency after the other, while it is recorded."""
        for number, share in enumerate(SHARES):
            frequency = round(share * self._natural, 1)
            self._source.control("frequency", frequency)
            self._tell(f"{frequency:g} Hz, {number + 1} of {len(SHARES)}", running=True)
            time.sleep(DWELL)
            if not self._records.under_way:
                break

    def _run(self) -> None:
        try:
            try:
                self._drive()
                self._records.stop()  # says so where the record has ended before the run was done
            finally:  # nothing that ends the run leaves the rig driven at resonance
                with contextlib.suppress(FitError, ValueError):
                    self._source.control("frequency", self._before)
            settings = {"component": self._component, "mass": f"{self._mass:g}"}
            task = self._tasks.run("rig", [self._name], settings)
            self._tell(f"{self._name}: identification", task=task)
        except (FitError, ValueError) as problem:
            self._tell(f"ended early: {problem}")
            self._log.say(f"stepped-sine run: {problem}", kind="error")
