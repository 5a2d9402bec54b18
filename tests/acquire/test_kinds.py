"""Set-ups of devices: what is taken and refused, and what is said where a library is missing."""

import sys

import pytest

from aerobalance.acquisition.setup import parse_setup, setup_text, stored_channels
from aerobalance.acquisition.source import SourceChannel
from aerobalance.acquisition.sources import open_source
from aerobalance.io.hdf5_contents import contents
from aerobalance.io.hdf5_layout import BlockWriter, Provenance
from aerobalance.recording.errors import FitError, ReadError

OPENDAQ = '[source]\nkind = "opendaq"\naddress = "daq.nd://10.0.0.5:7420"\n'
NI = """
[source]
kind = "nidaqmx"
rate = 25000.0
skew = 1.3e-6

[source.inputs.rN1]
physical = "PXI1Slot2/ai0"
measures = "bridge"
low = -2.0
high = 2.0
excitation = 10.0

[source.inputs.ground_acceleration_tip]
physical = "PXI1Slot2/ai1"
measures = "acceleration"
low = -50.0
high = 50.0
sensitivity = 100.0

[channels.rN1]

[channels.ground_acceleration_tip]
place = [0.5, 0.0, 0.1]
axis = "up"
place_uncertainty = 1e-3
delay = 2e-5
"""

WRONG = {
    "no address": (OPENDAQ.replace("address", "adress"), ["source.address", "is missing"]),
    "address of another kind": (OPENDAQ.replace("daq.nd", "http"), ["source.address", "http://"]),
    "address with a space": (OPENDAQ.replace(":7420", " :7420"), ["source.address"]),
    "no rate": (NI.replace("rate = 25000.0", ""), ["source.rate", "is missing"]),
    "unknown key": (NI.replace("excitation", "excitement"), ["source.inputs.rN1.excitement", "excitation"]),
    "bridge without excitation": (NI.replace("excitation = 10.0", ""), ["source.inputs.rN1", "excitation [V]"]),
    "accelerometer without sensitivity": (NI.replace("sensitivity = 100.0", ""), ["sensitivity [mV/g]"]),
    "range upside down": (NI.replace("high = 2.0", "high = -3.0"), ["source.inputs.rN1", "low must be below high"]),
    "several inputs in one": (NI.replace("ai0", "ai0:3"), ["source.inputs.rN1.physical"]),
    "an input twice": (NI.replace("ai1", "ai0"), ["source.inputs", "pxi1slot2/ai0 is given twice"]),
    "skew that does not fit": (NI.replace("1.3e-6", "5e-5"), ["source", "do not fit into an interval"]),
    "server without port": (NI.replace("skew", 'server = "10.0.0.5"\nskew'), ["source.server"]),
    "no inputs": ('[source]\nkind = "nidaqmx"\nrate = 5.0\ninputs = {}\n', ["source.inputs", "at least 1"]),
    "no axis": (
        NI.replace('axis = "up"', ""),
        ["channels.ground_acceleration_tip.axis", "is needed", "aft, right, up"],
    ),
    "axis of no length": (NI.replace('"up"', "[1.0, 1.0, 0.0]"), ["axis", "length 1"]),
    "place of a load": (NI.replace("[channels.rN1]", '[channels.rN1]\nplace = "0, 0, 1"'), ["channels.rN1", "place"]),
    "uncertainty of no place": (
        NI.replace("place = [0.5, 0.0, 0.1]", ""),
        ["channels.ground_acceleration_tip.place_uncertainty", "goes with a place"],
    ),
    "place that is none": (NI.replace("[0.5, 0.0, 0.1]", '"here"'), ["place", "three numbers"]),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_set_up_of_a_device_says_what_and_where(name) -> None:
    text, parts = WRONG[name]
    with pytest.raises(ReadError) as caught:
        parse_setup(text)
    for part in parts:
        assert part in str(caught.value)


@pytest.mark.parametrize("text", [OPENDAQ, NI])
def test_written_set_up_reads_back_the_same(text) -> None:
    setup = parse_setup(text)
    assert parse_setup(setup_text(setup)) == setup


def test_place_and_axis_may_be_typed_into_one_field() -> None:
    typed = NI.replace("[0.5, 0.0, 0.1]", '"0.5, 0,0.1"').replace('"up"', '"0,0,1"')
    assert parse_setup(typed) == parse_setup(NI)


def test_place_axis_and_skew_are_in_the_recording(tmp_path) -> None:
    given = (SourceChannel("rN1", "mV/V"), SourceChannel("ground_acceleration_tip", "m/s^2", delay=-1.3e-6))
    channels = stored_channels(parse_setup(NI), given)
    BlockWriter(tmp_path / "run.h5", channels, rate=1.0, rows=4, provenance=Provenance("test")).finish("done")
    tip = contents(tmp_path / "run.h5").channels[1]
    assert (tip.place, tip.axis, tip.place_uncertainty) == ((0.5, 0.0, 0.1), (0.0, 0.0, 1.0), 1e-3)
    # what the set-up says of the sensor, and what the source knows of its converter
    assert tip.delay == 2e-5 - 1.3e-6


@pytest.mark.parametrize(("text", "module"), [(OPENDAQ, "opendaq"), (NI, "nidaqmx")])
def test_without_the_library_it_is_said_how_to_install_it(text, module, tmp_path, monkeypatch) -> None:
    # neither in this process nor in one that it starts for the library
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / f"{module}.py").write_text(f"raise ModuleNotFoundError(name={module!r})\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(FitError, match=rf"pip install 'aerobalance\[{module}\]'"):
        open_source(parse_setup(text), tmp_path)
