"""The stepped-sine run: the rig is driven at one frequency after the other, recorded, and identified."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any, Final

from aerobalance.recording.errors import FitError

if TYPE_CHECKING:
    from aerobalance.app.monitor.station import Station

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


class Sweep:
    """One run.

    Parameters
    ----------
    station
        Whose rig is driven.

    Raises
    ------
    ValueError
        The source has no drive, or a run is under way.
    """

    def __init__(self, station: Station) -> None:
        if station.sweep is not None and station.sweep["running"]:
            raise ValueError("a stepped-sine run is under way already")
        if "frequency" not in station.controls:
            raise ValueError("this source has no drive whose frequency can be set")
        watching = station.watching
        if watching is None or not watching.components:
            raise ValueError("the stepped-sine run needs dynamics, to know where the resonance is about")
        self._station = station
        self._natural = watching.frequencies[watching.components[0]]
        self._component = watching.components[0]
        self._mass = watching.masses[self._component]
        self._before = station.controls["frequency"]
        names = {item["name"] for item in station.recordings()}
        self._name = next(
            name for number in range(1, 10_000) if (name := f"stepped-sine-{number:03d}.h5") not in names
        )
        station.record(self._name, notes="stepped-sine run", seconds=None)
        self._tell(f"recording {self._name}", running=True)
        threading.Thread(target=self._run, daemon=True).start()

    def _tell(self, text: str, **more: Any) -> None:
        self._station.sweep = {"text": text, "running": False, **more}
        self._station.changed()

    def _run(self) -> None:
        station = self._station
        try:
            for number, share in enumerate(SHARES):
                frequency = round(share * self._natural, 1)
                station.control("frequency", frequency)
                self._tell(f"{frequency:g} Hz, {number + 1} of {len(SHARES)}", running=True)
                time.sleep(DWELL)
                if not station.recording:
                    break
            station.stop()  # says so where the record has ended before the run was done
            station.control("frequency", self._before)
            settings = {"component": self._component, "mass": f"{self._mass:g}"}
            task = station.tasks.run("rig", [self._name], settings)
            self._tell(f"{self._name}: identification", task=task)
        except (FitError, ValueError) as problem:
            self._tell(f"ended early: {problem}")
            station.say(f"stepped-sine run: {problem}", kind="error")
