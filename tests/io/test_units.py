"""Units at the edge, against their definitions."""

import subprocess
import sys

import numpy as np
import pytest

from aerobalance.recording import units
from aerobalance.recording.units import (
    ALLOWED,
    Conversion,
    conversion,
    conversion_for,
    edge_unit,
    expected_unit,
    readable,
)

POUND_FORCE = 0.45359237 * 9.80665  # international pound (1959) and standard gravity (1901), both exact
INCH = 0.0254

TABLE = [
    ("N", ["N", " N ", "newton"], 1),
    ("N", ["kN"], 1000),
    ("N", ["lbf", "lb", "lbs", "klbf/1000"][:3], POUND_FORCE),
    ("N", ["kgf"], 9.80665),
    ("N*m", ["N*m", "Nm", "N m", "N·m", "N-m", "N.m", "N⋅m"], 1),
    ("N*m", ["kN*m", "kNm", "kN m", "kN-m"], 1000),
    ("N*m", ["in-lbf", "in-lb", "in*lbf", "in·lbf", "lbf*in", "lb-in", "lbf-in", "in lbf"], INCH * POUND_FORCE),
    ("N*m", ["ft-lbf", "ft-lb", "lbf*ft", "lb-ft"], 12 * INCH * POUND_FORCE),
    ("N*m", ["kgf*m", "kgf-m"], 9.80665),
    ("m/s^2", ["m/s^2", "m/s2", "m/s**2", "m/s²", "m s-2", "m*s^-2", "m·s⁻²"], 1),
    ("m/s^2", ["g", "G", "gn", "g0"], 9.80665),
    ("m/s^2", ["mg"], 9.80665e-3),
    ("m/s^2", ["ft/s2", "ft/s^2"], 12 * INCH),
    ("rad/s^2", ["rad/s^2", "rad/s2", "rad/s²", "rad/sec^2"], 1),
    ("rad/s^2", ["deg/s^2", "°/s²"], np.pi / 180),
    ("mV/V", ["mV/V"], 1),
    ("mV/V", ["uV/V", "µV/V", "μV/V"], 1e-3),
    ("mV/V", ["V/V"], 1e3),
    ("rad", ["rad"], 1),
    ("rad", ["mrad"], 1e-3),
    ("rad", ["deg", "°", "degree", "degrees"], np.pi / 180),
    ("s", ["s", "sec"], 1),
    ("s", ["ms"], 1e-3),
    ("s", ["us", "µs"], 1e-6),
    ("s", ["min"], 60),
    ("Hz", ["Hz", "1/s"], 1),
    ("Hz", ["kHz"], 1000),
    ("1", ["1", "-", "dimensionless"], 1),
    ("1", ["%"], 0.01),
    ("m/s", ["m/s"], 1),
    ("m", ["mm"], 1e-3),
    ("V", ["V", "volt", "Volts"], 1),
    ("V", ["mV"], 1e-3),
    ("V", ["uV", "µV"], 1e-6),
]


@pytest.mark.parametrize(("inside", "spellings", "factor"), TABLE)
def test_factors_are_those_of_the_definitions(inside, spellings, factor):
    for text in spellings:
        found = conversion(text, expected=inside)
        assert found.unit == inside
        assert found.factor == pytest.approx(factor, rel=1e-15), text


@pytest.mark.parametrize("expected", ALLOWED)
def test_units_that_are_named_as_allowed_are_read(expected):
    for text in ALLOWED[expected].split(", "):
        assert conversion(text, expected=expected).unit == expected


@pytest.mark.parametrize(
    ("text", "expected", "said"),
    [
        ("kg", "N", "a force is expected.*lbf"),
        ("g", "N", "a force is expected"),
        ("m", "rad", "is a length.*an angle.*deg"),
        ("1", "rad", "is a ratio"),
        ("%", "mV/V", "is a ratio, but a gauge output"),
        ("mV", "mV/V", "a gauge output"),
        ("mV/V", "1", "is a gauge output"),
        ("rad", "1", "is an angle"),
        ("dB", "1", "is not a ratio"),
        ("rad/s", "Hz", "a frequency is expected"),
        ("N", "N*m", "is a force"),
        ("m/s", "m/s^2", "is a velocity"),
        ("", "N", "unknown unit"),
        ("KN", "N", "a force is expected|unknown unit"),
        ("xyz", "N", "unknown unit"),
        ("V", "mV/V", "is a voltage, but a gauge output"),
        ("mV/V", "V", "is a gauge output, but a voltage"),
        ("A", "V", "a voltage is expected"),
        ("V", "degC", "is a voltage, but a temperature"),
        ("C", "degC", "a temperature is expected"),
        ("K/m", "degC", "a temperature is expected"),
    ],
)
def test_units_of_another_kind_are_refused_with_what_is_allowed(text, expected, said):
    with pytest.raises(ValueError, match=said):
        conversion(text, expected=expected)


@pytest.mark.parametrize("text", ["degC", "°C", "K", "psi", "rpm", "V", "Pa", "kg", "1"])
def test_units_of_other_quantities_are_kept(text):
    assert conversion(text) == Conversion(text, 1.0)


@pytest.mark.parametrize("text", ["9**9**9", "2**99", "__import__('os')", "))(", "", " ", "N" * 99, "a;b", "m**"])
def test_what_is_no_unit(text):
    assert not readable(text)
    with pytest.raises(ValueError, match="unknown unit"):
        conversion(text)


FIXED_POINTS = {"degC": (0, 100), "K": (273.15, 373.15), "degF": (32, 212), "degR": (491.67, 671.67)}
"""Ice point and steam point, by the definitions of the scales: 1 K = 1.8 degF, 0 degC = 273.15 K = 32 degF."""


@pytest.mark.parametrize("spelt", ["degC", "°C", "celsius", "deg C", "K", "kelvin", "degF", "°F", "deg F", "degR"])
def test_temperatures_have_a_factor_and_an_offset(spelt):
    unit = {"°C": "degC", "celsius": "degC", "deg C": "degC", "kelvin": "K", "°F": "degF", "deg F": "degF"}
    points = FIXED_POINTS[unit.get(spelt, spelt)]
    change = conversion(spelt, expected="degC")
    # Twice the rounding of a number near 700.
    np.testing.assert_allclose(change.inside(points), [0, 100], rtol=0, atol=2.3e-13)
    np.testing.assert_allclose(change.outside([0, 100]), points, rtol=0, atol=2.3e-13)


def test_an_uncertainty_of_a_temperature_is_a_difference():
    assert conversion_for("u_temperature", "K") == Conversion("degC", 1.0)
    assert conversion_for("u_temperature", "degF").inside(1.8) == pytest.approx(1, rel=1e-15)


@pytest.mark.parametrize("name", ["rNF", "rAF", "rN1", "rAft_Pitch", "rAx", "rRoll", "u_rRoll"])
def test_gauge_outputs_are_over_excitation_or_in_volts(name):
    assert expected_unit(name) == "mV/V"
    assert conversion_for(name, "uV/V") == Conversion("mV/V", 1e-3)
    assert conversion_for(name, "V/V") == Conversion("mV/V", 1e3)
    assert conversion_for(name, "V") == Conversion("V", 1.0)
    assert conversion_for(name, "mV") == Conversion("V", 1e-3)
    with pytest.raises(ValueError, match=r"is a force, but a gauge output.*mV/V, uV/V, V/V; or V, mV, uV beside"):
        conversion_for(name, "N")
    with pytest.raises(ValueError, match="is a ratio"):
        conversion_for(name, "1")


@pytest.mark.parametrize("spelled", sorted(units._USUAL))
def test_usual_units_are_those_of_the_library(spelled, monkeypatch):
    kind, _ = units._USUAL[spelled]
    short = conversion(spelled, expected=kind)
    monkeypatch.setattr(units, "_USUAL", {})
    assert conversion(spelled, expected=kind) == short


def test_usual_units_do_not_wait_for_the_library():
    program = (
        "import sys; from aerobalance.recording.units import conversion_for as c; c('AF', 'N'), c('pitch', 'deg')"
    )
    code = f"{program}; assert 'pint' not in sys.modules"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_milliseconds_stay_the_decimal_they_were():
    texts = [f"{i * 0.625:.3f}" for i in range(2000)]
    inside = conversion("ms", expected="s").inside([float(text) for text in texts])
    np.testing.assert_array_equal(inside, [float(f"{text}e-3") for text in texts])


def test_expected_units_by_name():
    assert expected_unit("AF") == "N"
    assert expected_unit("u_AF") == "N"
    assert expected_unit("u_phase") == "rad"
    assert expected_unit("rPM") == "mV/V"
    assert expected_unit("temperature") == "degC"
    assert expected_unit("excitation") == "V"
    assert expected_unit("humidity") is None
    assert edge_unit("pitch", "rad") == "deg"
    assert edge_unit("AF", "N") == "N"
    with pytest.raises(ValueError, match="expected must be one of"):
        conversion("N", expected="kN")
