"""Alarms stay until they are acknowledged."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from aerobalance.app.monitor.alarms import Alarms
from aerobalance.app.monitor.messages import ShownReading, Update, Watching
from aerobalance.balance.load_envelope import Utilisation
from helpers.running_page import Running

WATCHING = Watching(1, ("AF", "NF"), ("N", "N"), 1e3, 1, (), {"NF": 2000.0}, {"AF": (-1200.0, 500.0)}, {}, {})


def reading(least, largest, state="over"):
    return ShownReading((least + largest) / 2, least, largest, None, None, state)


class Watched:
    def __init__(self, watching=WATCHING) -> None:
        self.told, self.watching = 0, watching
        self.alarms = Alarms(self._tell)

    def _tell(self) -> None:
        self.told += 1

    def see(self, **changes):
        """An update; what is open after it."""
        self.alarms.watch(Update(0, 0.0, **changes), self.watching)
        return {one["what"]: one for one in self.alarms.shown["open"]}


def test_an_alarm_is_kept_with_its_worst_until_it_is_acknowledged() -> None:
    watched = Watched()
    assert watched.see(readings={"AF": reading(-10, 10, "ok"), "NF": reading(-10, 10, "ok")}) == {}
    assert watched.told == 0
    (alarm,) = watched.see(readings={"AF": reading(-1300, 20)}).values()
    assert (alarm["what"], alarm["text"], alarm["value"], alarm["unit"]) == ("AF", "below -1200 N", -1300, "N")
    assert alarm["present"] and alarm["acknowledged"] is None and watched.told == 1
    assert watched.see(readings={"AF": reading(-1500, 20)})["AF"]["value"] == -1500
    alarm = watched.see(readings={"AF": reading(-1250, 20)})["AF"]
    assert (alarm["value"], alarm["times"]) == (-1500, 1)
    over = watched.see(readings={"AF": reading(-10, 10, "ok")})["AF"]
    assert not over["present"]  # and still there
    told = watched.told
    assert watched.see(readings={"AF": reading(-10, 10, "ok")})["AF"] == over
    assert watched.told == told
    again = watched.see(readings={"AF": reading(0, 600)})["AF"]
    assert (again["present"], again["times"], again["value"]) == (True, 2, -1500)
    watched.see(readings={"AF": reading(-10, 10, "ok")})
    watched.alarms.acknowledge()
    shown = watched.alarms.shown
    assert shown["open"] == [] and [one["what"] for one in shown["past"]] == ["AF"]
    assert shown["past"][0]["acknowledged"] >= shown["past"][0]["began"]


def test_an_alarm_that_is_acknowledged_goes_when_it_is_over() -> None:
    watched = Watched()
    watched.see(readings={"NF": reading(0, 2100)})
    watched.alarms.acknowledge()
    assert watched.see(readings={"NF": reading(0, 2100)})["NF"]["acknowledged"]
    assert watched.see(readings={"NF": reading(0, 10, "ok")}) == {}
    # the next one is a new one, to be acknowledged again
    assert watched.see(readings={"NF": reading(0, 2100)})["NF"]["acknowledged"] is None


def test_a_contact_between_two_updates_is_an_alarm() -> None:
    watched = Watched()
    alarms = watched.see(remarks=[(5, "contact", "x"), (9, "contact over", "x")], touching=False)
    assert alarms["contact"]["present"]
    assert not watched.see(touching=False)["contact"]["present"]


def test_combined_loads_are_an_alarm() -> None:
    watched = Watched()
    used = Utilisation(1.2, "NF + PM", {"NF": 0.7, "PM": 0.5})
    alarms = watched.see(envelope=used, readings={"AF": reading(0, 1, "ok")})
    assert alarms["combined loads"]["value"] == pytest.approx(120)


def test_an_alarm_is_not_over_because_its_readings_end() -> None:
    watched = Watched()
    used = Utilisation(1.2, "NF + PM", {"NF": 0.7, "PM": 0.5})
    watched.see(envelope=used, readings={"AF": reading(0, 600)})
    silent = ShownReading(math.nan, math.nan, math.nan, None, None, "none")
    alarms = watched.see(readings={"AF": silent})
    assert alarms["AF"]["present"] and alarms["combined loads"]["present"]
    alarms = watched.see(envelope=used._replace(share=0.9), readings={"AF": reading(0, 10, "ok")})
    assert not alarms["AF"]["present"] and not alarms["combined loads"]["present"]


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("limit", "values", "shares"),
    [(10.0, (9.0, 1.0, -5.0, -7.0), (10 / 9, 10.0, math.inf, math.inf)), (0.0, (-1.0, -3.0), (math.inf, math.inf))],
)
def test_the_worst_is_kept_of_a_load_that_must_stay_beyond_a_limit(limit, values, shares, sign) -> None:
    """Above a lower limit of 10 N or 0; with the other sign below an upper one."""
    limits = (limit, math.inf) if sign == 1 else (-math.inf, -limit)
    watched = Watched(replace(WATCHING, limits={"AF": limits}))
    for value, share in zip(values, shares, strict=True):
        told = watched.told
        alarm = watched.see(readings={"AF": reading(sign * value, sign * value)})["AF"]
        assert (alarm["value"], alarm["share"]) == (sign * value, pytest.approx(share))
        assert watched.told == told + 1  # each is worse by more than 2 %
    assert watched.see(readings={"AF": reading(sign * values[0], sign * values[0])})["AF"] == alarm | {
        "last": pytest.approx(alarm["last"], abs=10)
    }


def test_an_alarm_of_the_rig_is_in_the_state_until_it_is_acknowledged(tmp_path) -> None:
    with Running(tmp_path) as running:
        running.wait(lambda state: state["numbers"].get("readings"))
        assert running.post("control", name="touch", value=1.0).status_code == 200
        running.wait(lambda state: any(one["present"] for one in state["alarms"]["open"]))
        assert running.post("control", name="release", value=1.0).status_code == 200
        state = running.wait(lambda state: not any(one["present"] for one in state["alarms"]["open"]))
        assert [one["what"] for one in state["alarms"]["open"]] == ["contact"]
        assert running.post("acknowledge").status_code == 200
        state = running.client.get("/api/state").json()
        assert state["alarms"]["open"] == []
        assert [one["what"] for one in state["alarms"]["past"]] == ["contact"]
