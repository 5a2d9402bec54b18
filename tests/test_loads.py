"""Loads from gauge outputs: zeros, drift, tares, temperature, range, and what the uncertainty covers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.signal import lfilter

from aerobalance.balance.calibration.fit import calibrate
from aerobalance.balance.loads import Loads, static_uncertainty
from aerobalance.balance.loads_of_outputs import loads_of_outputs
from aerobalance.balance.matrix import BalanceMatrix, TemperatureEffect
from aerobalance.balance.reduction import reduce_outputs
from aerobalance.balance.steady_means import batch_means, variance_of_drift, variance_of_mean
from aerobalance.balance.terms import KINDS, terms_of
from aerobalance.balance.weighing import LoadPoints, Weighing, fit_weight
from aerobalance.balance.wind_off import wind_off_loads
from aerobalance.balance.zeros import GaugeZero, Zero, gauge_table, gauge_zero
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.force import estimate_force
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.components import COMPONENTS, MOMENTS
from aerobalance.recording.errors import DataQualityWarning, FitError
from aerobalance.recording.recording import Recording
from aerobalance.simulation.calibration_stand import CAPACITIES, CalibrationStand, random_balance

RATE = 1000.0
NOISE = 2e-4  # of a reading of a bridge [mV/V]


@pytest.fixture
def balance(seed: int) -> BalanceMatrix:
    return replace(random_balance(seed), natural_zero=None)


def recorded(outputs: Array, *, extra: Mapping[str, tuple[str, Array]] | None = None, name: str = "run") -> Recording:
    """A recording of gauge outputs, in the order of the stand's balance."""
    names = ("N1", "N2", "S1", "S2", "RM", "AF")
    channels = {f"r{gauge}": Channel(f"r{gauge}", outputs[:, i], "mV/V") for i, gauge in enumerate(names)}
    for key, (unit, values) in (extra or {}).items():
        channels[key] = Channel(key, values, unit)
    return Recording.from_columns(np.arange(len(outputs)) / RATE, channels, name=name)


def swinging(count: int, generator: np.random.Generator) -> Array:
    """Loads of all components that wander over 0.6 of the range, shape (n, 6)."""
    time = np.arange(count) / RATE
    phases, speeds = generator.uniform(0, 6, 6), generator.uniform(1, 5, 6)
    return 0.6 * CAPACITIES * np.sin(2 * np.pi * speeds * time[:, None] + phases)


def linear_balance(coefficients: Array) -> BalanceMatrix:
    """A balance of 100 N and N*m at 1 mV/V, whose bridges feel the loads over capacity by a matrix, (6, 6)."""
    return BalanceMatrix(
        components=COMPONENTS,
        gauges=COMPONENTS,
        way="iterative",
        terms=terms_of("linear", 6),
        coefficients=coefficients,
        load_scale=np.full(6, 100.0),
        output_scale=np.ones(6),
        covariance=np.zeros((6, 6, 6)),
        residual_deviation=np.full(6, 1e-4),
        residual_correlation=np.eye(6),
        degrees_of_freedom=np.full(6, 50),
        calibrated=np.array([[-100.0] * 6, [100.0] * 6]),
        natural_zero=None,
        moments=np.array([name in MOMENTS for name in COMPONENTS]),
    )


def zeroed(outputs: Array) -> GaugeZero:
    return GaugeZero(outputs, np.zeros(6), "known", np.zeros(6), model_on=False)


NONE = zeroed(np.zeros(6))


def in_direct(balance: BalanceMatrix, native: Array) -> Array:
    """NF = N1 + N2, PM = x1 N1 - x2 N2, and so on, written out."""
    g = balance.geometry
    assert g is not None
    n1, n2, s1, s2, rm, af = native.T
    x1, x2 = g.normal
    y1, y2 = g.side
    return np.column_stack([n1 + n2, x1 * n1 - x2 * n2, s1 + s2, y1 * s1 - y2 * s2, rm, af])


def test_loads_of_a_known_balance_come_back(balance: BalanceMatrix, rng) -> None:
    native = swinging(500, rng)
    zero = rng.normal(0, 0.3, 6)
    felt = loads_of_outputs(recorded(balance.outputs(native) + zero), balance, zero=zeroed(zero))
    assert felt.components == ("NF", "PM", "SF", "YM", "RM", "AF")
    assert felt.units == ("N", "N*m", "N", "N*m", "N*m", "N")
    # the iteration ends at 1e-12 of capacity; sums of two loads, and noise-free outputs rounded at 1e-16 of 1 mV/V
    assert np.allclose(felt.values, in_direct(balance, native), atol=1e-10 * CAPACITIES.max(), rtol=0)
    assert not felt.beyond


def test_bridges_that_are_read_one_after_the_other_are_brought_together(rng) -> None:
    """As a multiplexer reads them, with a gap in one: loads of the instants in their middle."""
    count, late = 2000, np.array([0.0, 0.4e-3, 0.8e-3, 1.2e-3, 1.6e-3, 2.0e-3])
    time, turn = np.arange(count) / RATE, 2 * np.pi * np.array([60.0, 45.0, 30.0, 70.0, 20.0, 55.0])
    balance = linear_balance(np.eye(6) + 0.05 * rng.normal(size=(6, 6)))

    def loads_at(at: Array) -> Array:
        return 50 * np.sin(turn * at[:, None])

    outputs = np.column_stack([balance.outputs(loads_at(time - by))[:, i] for i, by in enumerate(late)])
    outputs[1000:1004, 3] = np.nan
    channels = {
        f"r{name}": Channel(f"r{name}", column, "mV/V", delay=float(by))
        for name, column, by in zip(balance.gauges, outputs.T, late, strict=True)
    }
    found = loads_of_outputs(Recording.from_columns(time, channels), balance, zero=NONE)
    assert found.recording.channel("NF").delay == pytest.approx(late.mean())
    error = np.abs(found.values - loads_at(time - late.mean()))[20:-20] / 50
    assert np.nanmax(error) < 1e-5  # the interpolation errs by 3e-6 of a channel, which feels others by 5 %
    # 0.2 samples after one that was read, each is made of ten from before and ten from after it
    assert np.flatnonzero(np.isnan(found.values[20:-20, 0])).tolist() == list(range(980 - 10, 984 + 9))


def test_a_zero_is_the_mean_and_its_drift_is_taken_off(balance: BalanceMatrix, rng) -> None:
    native = swinging(2000, rng)
    zero, drift = rng.normal(0, 0.3, 6), rng.normal(0, 0.003, 6)
    progress = np.linspace(0, 1, 2000)[:, None]
    run = recorded(balance.outputs(native) + zero + progress * drift)
    before = recorded(zero + rng.normal(0, NOISE, (4000, 6)), name="before")
    after = recorded(zero + drift + rng.normal(0, NOISE, (4000, 6)), name="after")
    found = gauge_zero([before], balance, after=[after], model_on=False)
    # the means of 4000 readings, within five standard errors
    assert np.allclose(found.values, zero, atol=5 * NOISE / np.sqrt(4000))
    assert np.allclose(found.drift, drift, atol=5 * NOISE * np.sqrt(2 / 4000))
    felt = loads_of_outputs(run, balance, zero=found)
    error = np.max(np.abs(felt.values - in_direct(balance, native)), axis=0)
    # u of the zero, through the sensitivities (capacity at about 1.1 mV/V), with ten per cent for interactions
    allowed = 5 * NOISE * np.sqrt(2 / 4000) / balance.output_scale.min() * CAPACITIES.max() * 2 * 1.1
    assert error.max() < allowed
    plain = loads_of_outputs(run, balance, zero=gauge_zero([before], balance, model_on=False))
    assert np.max(np.abs(plain.values - in_direct(balance, native))) > 3 * error.max()


def at_rest(
    generator: np.random.Generator, zero: Array, *, moved: Array | float = 0.0, name: str = "zero"
) -> Recording:
    """A zero of 4000 readings in which bridges move to another place after three quarters, and stay there [mV/V]."""
    later = np.arange(4000)[:, None] >= 3000
    return recorded(zero + moved * later + generator.normal(0, NOISE, (4000, 6)), name=name)


def test_a_zero_that_moved_is_doubted_and_counts(balance: BalanceMatrix, rng) -> None:
    native = swinging(500, rng)
    zero, moved = rng.normal(0, 0.3, 6), np.zeros(6)
    moved[5] = 0.1  # 500 times the noise of a reading, and a tenth of the range of AF
    found = gauge_zero([at_rest(rng, zero, moved=moved)], balance, model_on=False)
    run = recorded(balance.outputs(native) + zero)
    with pytest.warns(DataQualityWarning, match="zero moves while it is read.* of AF"):
        felt = loads_of_outputs(run, balance, zero=found)
    doubts = {doubt.component: doubt for doubt in felt.doubts}
    # of a quarter of the record off by d the standard deviation is d sqrt(3) / 4, and the mean is off by d / 4; the
    # sensitivity is taken at the median load, and changes by some per cent along the loads
    error = felt.values[:, 5] - in_direct(balance, native)[:, 5]
    assert doubts["AF"].kind == "zero"
    assert doubts["AF"].effect == pytest.approx(np.sqrt(3) * np.sqrt(np.mean(error**2)), rel=0.1)
    assert doubts["AF"].effect < felt.calibration[:, 5].mean()


@pytest.mark.parametrize("size", [0.0, 0.01])
def test_drift_of_a_zero_is_not_doubted(size, balance: BalanceMatrix, rng) -> None:
    zero = rng.normal(0, 0.3, 6)
    # a hundredth of the range from one zero to the next is much, but bridges do it; within one a tenth of that
    before = at_rest(rng, zero, moved=size / 10, name="before")
    after = at_rest(rng, zero + size, name="after")
    found = gauge_zero([before], balance, after=[after], model_on=False)
    assert loads_of_outputs(recorded(balance.outputs(swinging(500, rng)) + zero), balance, zero=found).doubts == ()


def test_a_jump_between_two_zeros_is_doubted(balance: BalanceMatrix, rng) -> None:
    zero, jump = rng.normal(0, 0.3, 6), np.zeros(6)
    jump[5] = 0.1
    found = gauge_zero([at_rest(rng, zero)], balance, after=[at_rest(rng, zero + jump, name="after")], model_on=False)
    late = np.arange(2000)[:, None] >= 1000  # in the middle of the run
    native = swinging(2000, rng)
    with pytest.warns(DataQualityWarning, match="zero after the run differ"):
        felt = loads_of_outputs(recorded(balance.outputs(native) + zero + jump * late), balance, zero=found)
    (doubt,) = [one for one in felt.doubts if one.component == "AF"]
    error = felt.values[:, 5] - in_direct(balance, native)[:, 5]
    assert doubt.effect == pytest.approx(np.sqrt(np.mean(error**2)), rel=0.1)  # sensitivities, as above


def test_zeros_that_contradict_each_other_are_doubted_and_count(balance: BalanceMatrix, rng) -> None:
    zero, apart = rng.normal(0, 0.3, 6), np.zeros(6)
    apart[5] = 0.1
    native = np.tile(0.4 * CAPACITIES, (200, 1))
    run, zeros = (
        recorded(balance.outputs(native) + zero),
        [at_rest(rng, zero), at_rest(rng, zero + apart, name="other")],
    )
    with pytest.warns(DataQualityWarning, match="zero, other are zeros that differ by .* of AF"):
        felt = reduce_outputs(run, balance, zero=Zero(zeros, model_on=False))
    # of two values the standard uncertainty of the mean is half of what they differ by: as far off as either may be
    assert felt.zero.u[5] == pytest.approx(0.05, abs=5 * NOISE / np.sqrt(4000))
    (doubt,) = [one for one in felt.doubts if one.component == "AF"]
    error = felt.values[:, 5] - in_direct(balance, native)[:, 5]
    # sensitivities change by some per cent between the load and the load with the error
    assert doubt.effect == pytest.approx(np.sqrt(np.mean(error**2)), rel=0.1)
    assert doubt.effect < 1.01 * felt.calibration[:, 5].mean()


@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")  # of the weight along others
def test_zeros_under_the_weight_at_several_attitudes_may_differ(balance: BalanceMatrix, rng) -> None:
    """A zero is the mean of those at 0 and 10 deg as well, if the weight in each is known."""
    weighing = weighed(rng)

    def at(degrees: float, force: float, name: str) -> Recording:
        pitch = np.full(800, np.radians(degrees))
        native = np.zeros((800, 6))
        native[:, 5] = force + 50.0 * np.sin(pitch)
        return recorded(balance.outputs(native), extra={"pitch": ("rad", pitch)}, name=name)

    zeros = Zero([at(10.0, 0.0, "first"), at(0.0, 0.0, "second")], model_on=True)
    felt = reduce_outputs(at(6.0, 120.0, "run"), balance, zero=zeros, tare=weighing)
    assert felt.doubts == ()
    assert felt.zero.u.max() < 1e-9  # there is no noise


def test_a_run_is_not_its_own_zero(balance: BalanceMatrix, rng) -> None:
    run = recorded(balance.outputs(swinging(2000, rng)) + rng.normal(0, NOISE, (2000, 6)))
    copy = replace(run, name="copy of the run")
    rest = at_rest(rng, np.zeros(6))
    with pytest.raises(FitError, match="copy of the run has the readings of the run run itself: it is no zero"):
        reduce_outputs(run, balance, zero=Zero(copy, model_on=False))
    with pytest.raises(FitError, match="no zero after the run"):
        reduce_outputs(run, balance, zero=Zero(rest, model_on=False, after=copy))
    with pytest.raises(FitError, match="no tare"):
        reduce_outputs(run, balance, zero=Zero(rest, model_on=False), tare=[copy])
    with pytest.raises(FitError, match="no zero"):  # of a run that is worked on in parts
        reduce_outputs(run.part(700, 1500), balance, zero=Zero(copy, model_on=False))
    assert reduce_outputs(run, balance, zero=Zero(rest, model_on=False)).doubts == ()


def weighed(rng: np.random.Generator) -> Weighing:
    """A weighing of 50 N along AF alone."""
    pitch = np.radians(np.arange(-10.0, 11, 2))
    load = 50.0 * np.sin(pitch) + rng.normal(0, 0.01, pitch.size)
    return fit_weight(LoadPoints(("AF",), pitch, load[:, None], np.zeros_like(pitch), None))


def test_weight_of_a_weighing_is_taken_off_where_it_is_known(balance: BalanceMatrix, rng) -> None:
    """AF at rest reads +W sin(pitch); of 11 points with 0.01 N noise W is known to 0.02 N, so five times that."""
    pitch = np.full(800, np.radians(6.0))
    native = np.zeros((800, 6))
    native[:, 5] = 120.0 + 50.0 * np.sin(pitch)
    run = recorded(balance.outputs(native), extra={"pitch": ("rad", pitch)})
    rest = recorded(rng.normal(0, 1e-6, (800, 6)), name="zero")
    zero, weighing = Zero(rest, model_on=False), weighed(rng)
    with pytest.warns(DataQualityWarning, match="knows the weight along AF only; that along NF, PM"):
        loads = reduce_outputs(run, balance, zero=zero, tare=weighing)
    assert np.allclose(loads.values[:, loads.components.index("AF")], 120.0, atol=0.1, rtol=0)
    with pytest.raises(ValueError, match="would take it off twice"):
        reduce_outputs(run, balance, zero=zero, tare=weighing, model=weighing)
    with pytest.raises(ValueError, match="cannot go with a weighing"):
        reduce_outputs(run, balance, zero=zero, tare=weighing, form="force")
    with pytest.raises(FitError, match="zero has no channel pitch, so the weight in its zero is not known"):
        reduce_outputs(run, balance, zero=Zero(rest, model_on=True), tare=weighing)


@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")  # of the weight along others
def test_errors_of_a_weighing_are_common_to_the_components(balance: BalanceMatrix, rng) -> None:
    """NF and AF have one mass and one misalignment: the errors of the two are those that the weighing says."""
    points = np.radians(np.arange(-10.0, 11, 2))
    weight = np.column_stack([-50.0 * np.cos(points), 50.0 * np.sin(points)]) + rng.normal(0, 0.01, (points.size, 2))
    weighing = fit_weight(LoadPoints(("NF", "AF"), points, weight, np.zeros_like(points), None))
    pitch = np.full(800, np.radians(6.0))
    run = recorded(balance.outputs(swinging(800, rng)), extra={"pitch": ("rad", pitch)})
    rest = recorded(rng.normal(0, 1e-6, (800, 6)), name="zero")
    loads = reduce_outputs(run, balance, zero=Zero(rest, model_on=False), tare=weighing)
    u = weighing.uncertainty(pitch=pitch[:1], offsets=False)[0]
    place = [loads.components.index(name) for name in ("NF", "AF")]
    expected = np.outer(u, u) * weighing.correlation(pitch=pitch[:1], offsets=False)
    assert expected[0, 1] != 0
    assert loads.of_tare[np.ix_(place, place)] == pytest.approx(expected, rel=1e-9)


def test_a_weighing_of_none_of_the_components_is_refused(seed: int, rng) -> None:
    """A force balance without the gauges' distances has no NF, along which the weight is known."""
    plain = replace(random_balance(seed), natural_zero=None, geometry=None)
    pitch = np.radians(np.arange(-30.0, 31, 6))
    load = -50.0 * np.cos(pitch) + rng.normal(0, 0.01, pitch.size)
    weighing = fit_weight(LoadPoints(("NF",), pitch, load[:, None], np.zeros_like(pitch), None))
    run, rest = (
        recorded(rng.normal(0, 1e-6, (800, 6)), extra={"pitch": ("rad", np.zeros(800))}, name=name)
        for name in ("run", "zero")
    )
    with (
        pytest.warns(DataQualityWarning, match="lacks the distances of the gauges"),
        pytest.raises(FitError, match="the weighing has NF, and the balance none of them but N1, N2"),
    ):
        reduce_outputs(run, plain, zero=Zero(rest, model_on=False), tare=weighing)


def test_loads_less_wind_off_loads_have_no_gravity_left(balance: BalanceMatrix, rng) -> None:
    extra = {"pitch": ("rad", np.full(800, 0.1)), "ground_acceleration": ("m/s^2", rng.normal(0, 0.01, 800))}
    run = recorded(rng.normal(0, NOISE, (800, 6)), extra=extra)
    loads = loads_of_outputs(run, balance, zero=NONE)
    assert loads.name in repr(loads)
    assert set(loads.without_gravity.recording.channels) == set(loads.recording.channels) - {"pitch"}
    ground = replace(loads.recording.channel("ground_acceleration"), coupling="dc")
    reading = replace(loads.recording, channels={**loads.recording.channels, ground.name: ground})
    with pytest.raises(FitError, match="ground_acceleration is dc-coupled and reads gravity"):
        _ = replace(loads, recording=reading).without_gravity


def test_a_zero_says_whether_the_model_was_on(balance: BalanceMatrix) -> None:
    with pytest.raises(ValueError, match="model_on"):
        loads_of_outputs(recorded(np.zeros((100, 6))), balance, zero=replace(NONE, model_on=None))


@pytest.mark.parametrize("said", [True, False])
def test_what_a_zero_says_may_come_from_an_array(said: bool) -> None:
    assert Zero(recorded(np.zeros((100, 6))), model_on=np.array([said])[0]).model_on is said


@pytest.mark.parametrize("said", [0, 1, None, "on"])
def test_a_zero_says_it_in_no_other_words(said) -> None:
    with pytest.raises(ValueError, match=f"a zero must say how it was read.*; not {said!r}"):
        Zero(recorded(np.zeros((100, 6))), model_on=said)


def test_a_run_among_its_tares_is_told(balance: BalanceMatrix, rng) -> None:
    pitch = np.zeros(800)
    run, other = (
        recorded(rng.normal(0, NOISE, (800, 6)), extra={"pitch": ("rad", pitch)}, name=name) for name in ("run", "off")
    )
    rest = recorded(rng.normal(0, NOISE, (800, 6)), name="zero")
    with pytest.warns(DataQualityWarning, match="run has the readings of the run run itself and is one of its tares"):
        reduce_outputs(run, balance, zero=Zero(rest, model_on=False), tare=[run, other])


def test_wind_off_loads_are_taken_off_at_the_same_pitch(balance: BalanceMatrix, rng) -> None:

    def weight(pitch: Array) -> Array:
        return np.column_stack(
            [-50 * np.cos(pitch), -40 * np.cos(pitch), 0 * pitch, 0 * pitch, 0 * pitch, 90 * np.sin(pitch)]
        )

    def at(pitch: Array, aero: Array, name: str) -> Recording:
        outputs = balance.outputs(weight(pitch) + aero)
        return recorded(outputs, extra={"pitch": ("rad", pitch)}, name=name)

    angles = np.radians(np.arange(-10, 11, 2.5))
    off = [at(np.full(50, angle), np.zeros((50, 6)), f"off {angle:.3f}") for angle in angles]
    pitch = np.radians(np.linspace(-9, 9, 400))
    aero = swinging(400, rng) / 3
    tare = wind_off_loads(at(pitch, aero, "on"), off, balance, zero=NONE)
    felt = loads_of_outputs(at(pitch, aero, "on"), balance, zero=NONE, tare=tare)
    # a chord of weight over 2.5 deg departs from the curve by at most h^2 / 8 of the curvature
    chord = np.radians(2.5) ** 2 / 8 * 100
    assert np.allclose(felt.values, in_direct(balance, aero), atol=1.01 * chord + 1e-6)
    with pytest.raises(FitError, match="add wind-off recordings"):
        wind_off_loads(at(pitch * 2, aero, "steep"), off, balance, zero=NONE)


def test_a_tare_is_known_as_well_as_the_mean_of_what_sways(balance: BalanceMatrix, rng) -> None:
    """An AR(1) process of r = 0.95: its mean scatters by sqrt((1 + r) / (1 - r)) = 6.2 times that of white noise."""
    samples, count = 4000, 30
    run = recorded(np.zeros((50, 6)))
    tares, us = [], []
    for _ in range(count):
        sway = lfilter([1], [1, -0.95], rng.normal(0, NOISE, (samples + 200, 6)), axis=0)[200:]
        sway[::7, 2] = np.nan  # what is missing is in no mean
        value, u, *_ = wind_off_loads(run, [recorded(sway)], balance, zero=NONE)
        tares.append(value[0])
        us.append(u[0])
    stated = np.sqrt(np.mean(np.square(us), axis=0))
    # 30 means of six loads tell their standard deviation to 1 / sqrt(360) = 5 %; batches of 200 samples are correlated
    # by some per cent
    assert np.sqrt(np.mean((np.array(tares) / stated) ** 2)) == pytest.approx(1, abs=0.25)


def test_tares_before_and_after_a_run_at_its_pitch_count_by_their_mean(balance: BalanceMatrix, rng) -> None:
    """A line through two that are 0.02 deg apart would turn the noise of the run's pitch into a load."""
    pitch = np.radians(0.05) * rng.choice([-1.0, 1.0], 300)

    def at(degrees: float, force: float) -> Recording:
        outputs = balance.outputs(np.tile([0, 0, 0, 0, 0, force], (200, 1))) + rng.normal(0, 1e-6, (200, 6))
        return recorded(outputs, extra={"pitch": ("rad", np.full(200, np.radians(degrees)))})

    run = recorded(np.zeros((300, 6)), extra={"pitch": ("rad", pitch)})
    value, u, *_ = wind_off_loads(run, [at(0.01, 10.0), at(-0.01, 20.0)], balance, zero=NONE)
    # half of what two differ by, as above
    assert np.allclose(value[:, 5], 15.0, atol=1e-3)
    assert np.allclose(u[:, 5], 5.0, atol=1e-3)
    # at 0 deg their mean, and from there the line to the next
    value, u, *_ = wind_off_loads(
        run, [at(0.01, 10.0), at(5.0, 45.0), at(-0.01, 20.0), at(-5.0, 45.0)], balance, zero=NONE
    )
    assert np.allclose(value[:, 5], 15.0 + 30.0 * np.abs(np.degrees(pitch)) / 5, atol=1e-3)
    assert np.allclose(u[:, 5], 5.0 * (1 - np.abs(np.degrees(pitch)) / 5), atol=1e-3)


def test_tares_of_unknown_attitude_count_by_what_they_differ_by(balance: BalanceMatrix, rng) -> None:
    off = [
        recorded(balance.outputs(np.tile([0, 0, 0, 0, 0, force], (200, 1))) + rng.normal(0, 1e-6, (200, 6)))
        for force in (10.0, 20.0)
    ]
    value, u, *_ = wind_off_loads(recorded(np.zeros((50, 6))), off, balance, zero=NONE)
    # half of what two differ by; noise of 1e-6 mV/V is some 1e-4 N
    assert value[0, 5] == pytest.approx(15.0, abs=1e-3)
    assert u[0, 5] == pytest.approx(5.0, abs=1e-3)
    lost = recorded(np.where(np.arange(3)[:, None] == 0, 0.0, np.full((3, 6), np.nan)), name="lost")
    with pytest.raises(FitError, match="lost: fewer than two samples have all loads"):
        wind_off_loads(recorded(np.zeros((50, 6))), [lost], balance, zero=NONE)


def test_temperature_effects_are_taken_out(balance: BalanceMatrix, rng) -> None:
    effects = {
        name: TemperatureEffect(20.0, rng.normal(0, 1e-3), 0.0, rng.normal(0, 1e-3), 0.0)
        for name in balance.components
    }
    warm = replace(balance, temperature=effects)
    native = swinging(300, rng)
    temperature = 25 + 5 * np.sin(np.linspace(0, 6, 300))
    change = temperature[:, None]
    gain = np.array([effect.sensitivity for effect in effects.values()])
    slope = np.array([effect.zero for effect in effects.values()])
    outputs = balance.outputs(native) * (1 + gain * (change - 20)) + slope * (change - temperature.mean())
    run = recorded(outputs, extra={"temperature": ("degC", temperature)})
    felt = loads_of_outputs(run, warm, zero=NONE)
    assert np.allclose(felt.values, in_direct(balance, native), atol=1e-10 * CAPACITIES.max())
    left = loads_of_outputs(run, balance, zero=NONE).values - in_direct(balance, native)
    assert np.abs(left).max() > 1e-3 * CAPACITIES.min()


def test_natural_zeros_move_with_the_temperature_since_the_calibration(balance: BalanceMatrix, rng) -> None:
    effects = {
        name: TemperatureEffect(20.0, rng.normal(0, 1e-3), 1e-4, rng.normal(0, 1e-3), 0.0)
        for name in balance.components
    }
    natural = rng.normal(0, 0.3, 6)
    warm = replace(balance, temperature=effects, natural_zero=natural)
    native, change = np.tile(0.4 * CAPACITIES, (40, 1)), 30.0
    slope, gain = np.array([(effect.zero, effect.sensitivity) for effect in effects.values()]).T
    outputs = balance.outputs(native) * (1 + gain * change) + natural + slope * change
    run = recorded(outputs, extra={"temperature": ("degC", np.full(40, 20.0 + change))})
    with pytest.warns(DataQualityWarning, match="moved since, but for what temperature does to them, goes"):
        felt = loads_of_outputs(run, warm)
    assert np.allclose(felt.values, in_direct(balance, native), atol=1e-10 * CAPACITIES.max())
    # the zeros are known to 30 K times 1e-4 mV/V/K; sensitivities are drawn 3 % off, and 15 % is five times that
    by_zero = np.sqrt((felt.transform @ balance.sensitivity(native[:1])[0]) ** 2 @ np.full(6, (change * 1e-4) ** 2))
    assert np.allclose(np.sqrt(felt.apart[0]), by_zero, rtol=0.15)


def test_what_is_not_known_of_the_temperature_effects_is_in_the_uncertainty(balance: BalanceMatrix, rng) -> None:
    small = 1e-5  # [mV/V/K] and [1/K]: over 30 K the second order is 3e-4 of the first
    effects = {
        name: TemperatureEffect(20.0, rng.normal(0, 1e-3), small, rng.normal(0, 1e-3), small)
        for name in balance.components
    }
    warm = replace(balance, temperature=effects)
    temperature = np.linspace(30.0, 50.0, 40)
    native = np.tile(0.4 * CAPACITIES, (40, 1))  # one load, at which the matrix has one slope
    run = recorded(balance.outputs(native), extra={"temperature": ("degC", temperature)})
    felt = loads_of_outputs(run, warm, zero=NONE)
    # the same with each of the twelve effects off by its uncertainty
    expected = np.zeros_like(felt.values)
    for name, effect in effects.items():
        for off in (
            replace(effect, zero=effect.zero + small),
            replace(effect, sensitivity=effect.sensitivity + small),
        ):
            other = loads_of_outputs(run, replace(warm, temperature={**effects, name: off}), zero=NONE)
            expected += (other.values - felt.values) ** 2
    known = {name: replace(effect, u_zero=0.0, u_sensitivity=0.0) for name, effect in effects.items()}
    without = loads_of_outputs(run, replace(warm, temperature=known), zero=NONE)
    # zeros that moved by up to 1e-2 mV/V, and sensitivities by 3e-2, turn the slope of the matrix by as much
    assert np.allclose(felt.calibration**2 - without.calibration**2, expected, rtol=0.1)
    share = static_uncertainty(felt, forces={})["NF"] ** 2 - static_uncertainty(without, forces={})["NF"] ** 2
    assert np.allclose(share, expected[:, 0], rtol=0.1)


def test_without_a_temperature_its_effects_change_nothing(balance: BalanceMatrix, rng) -> None:
    effect = TemperatureEffect(20.0, 1e-3, 1e-3, 1e-3, 1e-3)
    run = recorded(balance.outputs(swinging(40, rng)))
    plain, warm = (
        loads_of_outputs(run, replace(balance, temperature=effects), zero=NONE)
        for effects in ({}, dict.fromkeys(balance.components, effect))
    )
    np.testing.assert_array_equal(warm.values, plain.values)
    np.testing.assert_array_equal(warm.uncertainty, plain.uncertainty)
    assert warm.apart.shape == (1, 6)


def test_noise_of_the_bridges_becomes_noise_of_the_loads(balance: BalanceMatrix, rng) -> None:
    level = balance.outputs(0.3 * CAPACITIES[None, :])
    outputs = level + rng.normal(0, NOISE, (20000, 6))
    felt = loads_of_outputs(recorded(outputs), balance, zero=NONE)
    # the scatter of 20000 loads is known to 0.5 %; the level of white noise is read 2-5 % low by `channel_noise`
    assert np.allclose(felt.noise, felt.values.std(axis=0), rtol=0.08)


def test_noise_that_bridges_share_is_in_the_covariance_of_the_loads(balance: BalanceMatrix, rng) -> None:
    """An unsteady excitation moves all bridges at once: it is seen in their outputs, and adds up or cancels."""
    count = 20_000
    outputs = balance.outputs(np.tile(0.3 * CAPACITIES, (count, 1)))
    noise = NOISE * (rng.normal(size=(count, 6)) + 1.5 * rng.normal(size=(count, 1)) * np.array([1, 1, 1, 1, 0, 0]))
    felt = loads_of_outputs(recorded(outputs + noise), balance, zero=NONE)
    size = np.sqrt(np.diag(felt.noise_covariance))
    expected = np.corrcoef(felt.values.T)
    # over 20000 readings a correlation is known to 0.007; over the upper half of their spectrum, whose 5000 ordinates
    # weigh as 3700 after four differences, to 1 / sqrt(7400) = 0.012; five times both together
    assert np.allclose(felt.noise_covariance / np.outer(size, size), expected, rtol=0, atol=0.07)
    assert np.abs(expected - np.eye(6)).max() > 0.4


def test_uncertainty_covers_the_error_of_the_calibration(seed: int) -> None:
    errors = []
    for draw in range(12):
        truth = random_balance(seed + draw, model="abs")
        schedule = CalibrationStand(truth, noise=2e-3).run(seed + 100 + draw).schedule
        matrix = calibrate(schedule, model="abs").matrix
        native = swinging(200, np.random.default_rng(seed + draw))
        felt = loads_of_outputs(recorded(truth.outputs(native)), matrix, zero=NONE)
        errors.append((felt.values - in_direct(truth, native)) / felt.calibration)
    z = np.array(errors)
    # the stated uncertainty has the scatter of a reading in it besides, so errors of the matrix stay well inside
    assert np.sqrt(np.mean(z**2)) < 1
    assert np.mean(np.abs(z) < 2) > 0.95


def test_static_uncertainty_is_that_of_a_load_of_the_size_of_the_force(seed: int) -> None:
    truth = random_balance(seed, model="abs")
    matrix = calibrate(CalibrationStand(truth).run(seed).schedule, model="abs").matrix
    # loads of one sign: where one crosses zero the |F| terms turn, and the few parts in a thousand of capacity between
    # the loads found and the true ones could lie on two sides of that
    native = 0.5 * (CAPACITIES + swinging(50, np.random.default_rng(seed)))
    felt = loads_of_outputs(recorded(truth.outputs(native)), matrix, zero=NONE)
    same = static_uncertainty(felt, forces={})
    assert np.allclose(np.column_stack(list(same.values())), felt.calibration, rtol=1e-9)
    other = native.copy()
    other[:, 5] = 0.1 * CAPACITIES[5]  # AF is a load of its own in both forms
    forced = static_uncertainty(felt, forces={"AF": other[:, 5]})
    there = loads_of_outputs(recorded(truth.outputs(other)), matrix, zero=NONE)
    # u moves by no larger a share than the loads do
    assert np.allclose(np.column_stack(list(forced.values())), there.calibration, rtol=5e-3)


def test_beyond_the_calibration_is_doubted(balance: BalanceMatrix) -> None:
    native = np.tile(CAPACITIES * np.array([1.3, 0.1, 0.1, 0.1, 0.1, 0.1]), (40, 1))
    with pytest.warns(DataQualityWarning, match="N1 leaves the calibrated range"):
        felt = loads_of_outputs(recorded(balance.outputs(native)), balance, zero=NONE)
    assert felt.beyond == {"N1": 40}


def test_without_a_zero_it_is_said(balance: BalanceMatrix) -> None:
    outputs = balance.outputs(np.zeros((40, 6)))
    with pytest.warns(DataQualityWarning, match="the gauge outputs are taken as they are"):
        loads_of_outputs(recorded(outputs), balance)
    known = replace(balance, natural_zero=np.full(6, 0.1))
    with pytest.warns(DataQualityWarning, match="natural zeros of the calibration"):
        felt = loads_of_outputs(recorded(outputs + 0.1), known)
    assert np.allclose(felt.values, 0, atol=1e-8)


def test_missing_samples_stay_missing_and_missing_bridges_are_named(balance: BalanceMatrix) -> None:
    outputs = balance.outputs(np.zeros((40, 6)))
    outputs[7, 2] = np.nan
    felt = loads_of_outputs(recorded(outputs), balance, zero=NONE)
    assert np.flatnonzero(np.isnan(felt.values).any(axis=1)).tolist() == [7]
    run = recorded(outputs)
    channels = {name: channel for name, channel in run.channels.items() if name != "rS2"}
    with pytest.raises(FitError, match="no channel rS2 for the bridge S2"):
        loads_of_outputs(replace(run, channels=channels), balance, zero=NONE)


def test_bridges_go_by_other_usual_names(balance: BalanceMatrix) -> None:
    run = recorded(balance.outputs(np.zeros((40, 6))) + np.arange(6.0))
    renamed = {"rAF": "rAxial", "rRM": "rRoll", "rS1": "rY1"}
    channels = {
        renamed.get(name, name): replace(channel, name=renamed.get(name, name))
        for name, channel in run.channels.items()
    }
    table, _ = gauge_table(replace(run, channels=channels), balance)
    assert np.allclose(table, np.arange(6.0), atol=1e-12)


def test_outputs_far_outside_say_so(balance: BalanceMatrix) -> None:
    wild = recorded(np.full((40, 6), 30 * balance.output_scale))
    with (
        pytest.raises(FitError, match="no sample gives loads")
        if _unsolvable(balance)
        else pytest.warns(DataQualityWarning)
    ):
        loads_of_outputs(wild, balance, zero=NONE)


def _unsolvable(balance: BalanceMatrix) -> bool:
    return bool((balance.loads(30 * balance.output_scale[None, :]).steps == 0).all())


def test_outputs_in_another_unit_are_refused_and_named(balance: BalanceMatrix, rng) -> None:
    """uV/V are a thousand times mV/V, of all bridges or of one; what fails on the way is no matter of units."""
    outputs = balance.outputs(swinging(500, rng))
    with pytest.raises(FitError, match="so do 5 bridges more: readings or zero are in another unit"):
        loads_of_outputs(recorded(1e3 * outputs), balance, zero=NONE)
    one, late = outputs.copy(), outputs.copy()
    one[:, 4] *= 1e3
    with pytest.raises(FitError, match=r"rRM reads .* such as uV/V as mV/V, or the bridge is open; check the unit"):
        loads_of_outputs(recorded(one), balance, zero=NONE)
    late[300:, 4] = 1e3
    late = recorded(late)
    for failed_on_the_way in (late, late.part(250, 500)):
        with pytest.warns(DataQualityWarning):
            found = loads_of_outputs(failed_on_the_way, balance, zero=NONE)
        assert np.isfinite(found.values[:50]).all()


def test_outputs_that_are_next_to_nothing_are_doubted(balance: BalanceMatrix, rng) -> None:
    """V/V are a thousandth of mV/V; noise, and zeros of bridges that were set to nothing, are as small."""
    outputs = balance.outputs(swinging(500, rng))
    noise = 1e-7 * rng.normal(size=outputs.shape)
    with pytest.warns(DataQualityWarning, match="such as V/V as mV/V"):
        told = loads_of_outputs(recorded(1e-3 * outputs + noise), balance, zero=NONE).doubts
    assert {doubt.component for doubt in told if doubt.kind == "units"} == set(COMPONENTS)
    for sound in (noise, outputs, 1e-2 * outputs):
        told = loads_of_outputs(recorded(sound), balance, zero=NONE).doubts
        assert not [doubt for doubt in told if doubt.kind == "units"]


def test_a_recording_with_loads_keeps_its_other_channels(balance: BalanceMatrix) -> None:
    pitch = np.linspace(0, 0.1, 40)
    run = recorded(balance.outputs(np.zeros((40, 6))), extra={"pitch": ("rad", pitch)})
    felt: Loads = loads_of_outputs(run, balance, zero=NONE)
    ready = felt.recording
    assert set(ready.channels) == {"pitch", "NF", "PM", "SF", "YM", "RM", "AF"}
    assert np.array_equal(ready.channel("pitch").values, pitch)


def test_a_force_balance_is_of_that_form_without_distances(seed: int) -> None:
    """N1 N2 S1 S2 RM AF is what --form force asks for; only other forms need the places of the gauges."""
    plain = replace(random_balance(seed), geometry=None)
    native = swinging(50, np.random.default_rng(seed))
    felt = loads_of_outputs(recorded(plain.outputs(native)), plain, zero=NONE, form="force")
    assert felt.components == ("N1", "N2", "S1", "S2", "RM", "AF")
    np.testing.assert_allclose(felt.values, native, atol=1e-6 * np.abs(native).max())
    with pytest.raises(ValueError, match=r"calibrate with `Schedule\.geometry`"):
        loads_of_outputs(recorded(plain.outputs(native)), plain, zero=NONE, form="moment")


def test_tares_are_taken_off_in_the_form_that_is_asked_for(seed: int) -> None:
    plain = replace(random_balance(seed), geometry=None)
    native = swinging(50, np.random.default_rng(seed))
    still = np.tile(0.1 * CAPACITIES, (50, 1))
    off = wind_off_loads(recorded(native), [recorded(plain.outputs(still))], plain, zero=NONE, form="force")
    np.testing.assert_allclose(off.values[0], still[0], rtol=1e-6)
    felt = loads_of_outputs(recorded(plain.outputs(native + still)), plain, zero=NONE, tare=off, form="force")
    np.testing.assert_allclose(felt.values, native, atol=1e-6 * np.abs(native).max())


def test_averaged_points_are_told_to_need_their_noise(seed: int, rng) -> None:
    """What points at several loads differ by is no noise: it is told, until a map says what the noise is."""
    calibrated = replace(random_balance(seed), residual_deviation=np.full(6, 2e-4))
    points = recorded(calibrated.outputs(rng.uniform(-0.6, 0.6, (30, 6)) * CAPACITIES))
    with pytest.warns(DataQualityWarning, match=r"averaged points .*noise = .*channels\.rNAME"):
        felt = loads_of_outputs(points, calibrated, zero=NONE)
    known = {name: replace(channel, noise=2e-5) for name, channel in points.channels.items()}
    better = loads_of_outputs(replace(points, channels=known), calibrated, zero=NONE)
    assert (better.noise < 0.01 * felt.noise).all()
    # samples in time of the same size and length are not doubted
    slow = swinging(30, rng) + rng.normal(0, 1e-4, (30, 6)) * CAPACITIES
    loads_of_outputs(recorded(calibrated.outputs(slow)), calibrated, zero=NONE)


def test_an_uncertain_gain_of_a_bridge_is_that_of_its_load(seed: int) -> None:
    """Of linear bridges without interactions, a relative error of one output is the same of the load."""
    plain = random_balance(seed, model="linear")
    diagonal = replace(plain, coefficients=np.diag(np.diag(plain.linear)), natural_zero=None)
    native = swinging(50, np.random.default_rng(seed))
    run = recorded(diagonal.outputs(native))
    known = loads_of_outputs(run, diagonal, zero=NONE, form="force")
    gain = {name: replace(channel, relative_uncertainty=0.003) for name, channel in run.channels.items()}
    found = loads_of_outputs(replace(run, channels=gain), diagonal, zero=NONE, form="force")
    np.testing.assert_allclose(found.apart - known.apart, (0.003 * native) ** 2, rtol=1e-9, atol=1e-20)


def test_one_wind_off_recording_serves_a_run_at_its_pitch(balance: BalanceMatrix, rng) -> None:
    still = np.tile(0.1 * CAPACITIES, (400, 1))
    pitch = np.full(400, np.radians(4.0))
    outputs = balance.outputs(still) + rng.normal(0, NOISE, (400, 6))
    off = recorded(outputs, extra={"pitch": ("rad", pitch)}, name="off")
    run = recorded(balance.outputs(still), extra={"pitch": ("rad", pitch)})
    tare, u, *_ = wind_off_loads(run, [off], balance, zero=NONE)
    assert tare.shape == u.shape == (1, 6)
    # u is the noise over the root of 400 readings, itself 2 to 5 % low (see above); five of it
    assert (np.abs(tare[0] - in_direct(balance, still)[0]) < 5.5 * u[0]).all()
    away = recorded(balance.outputs(still), extra={"pitch": ("rad", pitch + np.radians(3.0))}, name="away")
    with pytest.raises(FitError, match="add wind-off recordings"):
        wind_off_loads(away, [off], balance, zero=NONE)


def bent(seed: int) -> BalanceMatrix:
    """Outputs x - 0.4 x^2 of the load x over capacity, each bridge of its own load alone: 0.625 at most, at 1.25."""
    straight = replace(random_balance(seed, model="quadratic"), natural_zero=None)
    coefficients = np.zeros_like(straight.coefficients)
    for place, term in enumerate(straight.terms):
        if term.first == term.second:
            coefficients[place, term.first] = {"{a}": 1.0, "{a}*{a}": -0.4}.get(KINDS[term.kind], 0.0)
    return replace(straight, coefficients=coefficients)


def test_samples_without_a_solution_are_told_and_missing(seed: int) -> None:
    balance = bent(seed)
    outputs = np.full((40, 6), 0.1) * balance.output_scale
    outputs[[5, 17], 3] = 0.7 * balance.output_scale[3]
    with pytest.warns(DataQualityWarning, match="2 of 40 samples have no loads that give their gauge outputs"):
        found = loads_of_outputs(recorded(outputs), balance, zero=NONE, form="force")
    assert np.flatnonzero(np.isnan(found.values).any(axis=1)).tolist() == [5, 17]
    # the smaller root of 0.4 x^2 - x + 0.1 = 0
    expected = (1 - np.sqrt(1 - 0.16)) / 0.8 * balance.load_scale
    np.testing.assert_allclose(np.nanmean(found.values, axis=0), expected, rtol=1e-10)


def test_interactions_that_nearly_keep_the_iteration_from_settling_are_told(seed: int) -> None:
    """The plain iteration x' = y + 0.4 x^2 shrinks an error by 0.8 x: 0.76 at 0.95 of capacity, 0.4 at half of it."""
    balance = bent(seed)
    large, small = (recorded(balance.outputs(np.tile(part * balance.load_scale, (40, 1)))) for part in (0.95, 0.5))
    with pytest.warns(DataQualityWarning, match=r"shrinks an error only by 0\.76 a step"):
        found = loads_of_outputs(large, balance, zero=NONE, form="force")
    assert found.contraction == pytest.approx(0.76)
    assert loads_of_outputs(small, balance, zero=NONE, form="force").contraction == pytest.approx(0.4)


def test_a_part_of_a_record_in_a_gap_has_missing_loads(balance: BalanceMatrix, rng) -> None:
    outputs = balance.outputs(rng.uniform(-0.3, 0.3, (120, 6)) * balance.load_scale)
    outputs[40:90, 2] = np.nan
    record = recorded(outputs)
    part = loads_of_outputs(record.part(50, 80), balance, zero=NONE)
    assert part.values.shape == (30, 6)
    assert np.isnan(part.values).all() and np.isnan(part.uncertainty).all() and not part.beyond
    outputs[:, 2] = np.nan
    with pytest.raises(FitError, match="no sample gives loads"):
        loads_of_outputs(recorded(outputs), balance, zero=NONE)


@pytest.mark.parametrize("noise", [0.0, NOISE])
def test_a_bridge_that_reads_nothing_is_dead_where_others_would_move_it(noise: float, rng) -> None:
    """Its load comes out as what takes off the interactions, 3 % of the others', and fluctuates as any load does."""
    coefficients = np.eye(6)
    coefficients[:5, 5] = 0.03  # what the bridge of AF feels of each other load
    balance = linear_balance(coefficients)
    time = np.arange(2000) / RATE
    loads = 30 * np.sin(2 * np.pi * np.array([3.0, 4.0, 5.0, 6.0, 7.0, 8.0]) * time[:, None])
    outputs = balance.outputs(loads) + rng.normal(0, NOISE, loads.shape)
    names = dict.fromkeys(f"r{name}" for name in balance.gauges)

    def doubts(columns: Array) -> dict[str, str]:
        channels = {name: Channel(name, column, "mV/V") for name, column in zip(names, columns.T, strict=True)}
        felt = loads_of_outputs(Recording.from_columns(time, channels, name="run"), balance, zero=NONE)
        return {doubt.component: doubt.text for doubt in felt.doubts if doubt.kind == "stuck channel"}

    assert not doubts(outputs)
    still = np.column_stack([0 * loads[:, :5], outputs[:, 5]]) + rng.normal(0, NOISE, loads.shape)
    assert not doubts(still)  # of bridges without a load none is dead
    dead = outputs.copy()
    dead[:, 5] = 0.01 + rng.normal(0, 1.0, time.size) * noise
    with pytest.warns(DataQualityWarning, match="rAF"):
        told = doubts(dead)
    assert set(told) == set(COMPONENTS)  # each force of coupled components needs the readings of all
    # five sines of 0.3 of capacity, each felt with 0.03: sqrt(5 / 2) 0.009 mV/V
    assert f"would move it by {np.sqrt(2.5) * 0.009:.2g} mV/V" in told["AF"]
    assert ("all along" in told["AF"]) == (noise == 0)


@pytest.mark.parametrize("after", [False, True])
def test_what_bridges_moved_by_since_their_zero_is_assumed_unless_it_was_read_again(after: bool, rng) -> None:
    """Half of range is 100 N, of which zeros repeat to 0.1 %; a drift of as much is an error of that size."""
    balance, own = linear_balance(np.eye(6)), Dynamics("AF", mass=10.0, stiffness=4e6, damping=100.0)
    time, drift = np.arange(4000) / RATE, np.full(6, 1e-3)
    load = np.zeros((time.size, 6))
    load[:, 5] = 20 * np.sin(2 * np.pi * 7 * time)  # a ninth of the natural frequency
    outputs = balance.outputs(load) + drift + rng.normal(0, NOISE, load.shape)
    channels = {f"r{name}": Channel(f"r{name}", one, "mV/V") for name, one in zip(COMPONENTS, outputs.T, strict=True)}
    zero = replace(NONE, drift=2 * drift * after)  # by which it moves from before the run to after it
    felt = loads_of_outputs(Recording.from_columns(time, channels, name="run"), balance, zero=zero)
    force = estimate_force(felt, own)
    told = {one.kind: one for one in force.assumed}
    assert ("zero drift" in told) != after
    if not after:
        assert told["zero drift"].effect == pytest.approx(0.1)
        error = np.mean(force.only.values) - np.mean(load[:, 5])
        # the mean of 4000 readings is off by 0.0003 N
        assert told["zero drift"].effect == pytest.approx(error, rel=0.2)


@pytest.mark.parametrize(("walks", "most"), [(0.0, 1.05), (20.0, 2.3), (60.0, 1.6)], ids=["white", "slight", "clear"])
def test_a_zero_whose_bridges_drift_is_as_uncertain_as_that(
    walks: float, most: float, balance: BalanceMatrix, rng
) -> None:
    """Random walks along the zero, as many times the noise of its mean: against where they end, as the run begins."""
    scores = []
    for _ in range(80):
        walk = np.cumsum(rng.normal(0, 1, (2000, 6)), axis=0) * walks * NOISE / 2000
        found = gauge_zero([recorded(walk + rng.normal(0, NOISE, (2000, 6)), name="zero")], balance, model_on=False)
        scores.append((found.values - walk[-1]) / found.u)
    # 480 values tell an rms of Gaussian ones to 4 %, of drifts, whose variance hardly tells itself, to some 8 %. Of
    # white noise it is 0.86, as a drift might be hidden; without the drift u was 5.5 and 6.4 times too small
    assert 0.72 < np.sqrt(np.mean(np.square(scores))) < most


def drifting(rng: np.random.Generator, kinds: Array, sizes: Array, readings: int = 100) -> tuple[Array, Array]:
    """Records at rest with a white noise of 1, shape (n, columns), and the levels that they end on, (columns,).

    Of the kind 1 is a random walk, of 2 a steady drift, of 0 none; the size is how far it leads from its mean to its
    end (rms), over the standard deviation of the mean by noise.
    """
    shape = (readings, len(kinds))
    walk = np.sqrt(3) / readings * rng.normal(size=shape).cumsum(axis=0)  # its mean is 1 / sqrt(3) from its end
    steady = 2 / np.sqrt(readings) * np.linspace(0, 1, readings)[:, None] * rng.normal(size=len(kinds))
    drift = sizes * np.select([kinds == 1, kinds == 2], [walk, steady], 0.0)
    return rng.normal(size=shape) + drift, drift[-1]


def test_errors_of_zeros_are_no_larger_on_average_than_stated_whatever_they_drift_by(rng) -> None:
    """The mean of (error / u)^2 over what is expected beforehand, which is 1 where u^2 is the expected square."""
    count = 20_000
    kinds, sizes = rng.choice(3, count, p=[0.9, 0.05, 0.05]), 10 * np.abs(rng.standard_cauchy(count))
    table, ends = drifting(rng, kinds, sizes)
    variance = variance_of_mean(table) + variance_of_drift(table)
    squares = (table.mean(axis=0) - ends) ** 2 / variance
    # it was 1.10, and is 0.88 with a standard deviation of 0.015: errors and stated variances are large together
    assert 0.8 < np.mean(squares) < 1.0
    # a u of twice the noise or more, where there is nothing else, was that of one record in 9.3; it is of one in 14.5
    assert np.mean(variance[kinds == 0] > 4 / len(table)) < 0.08


def test_drifts_of_some_times_the_noise_are_seldom_missed(rng) -> None:
    """The rms of error / u where drifts are as large as they must be to be seen, or hardly larger."""
    for kind, size, most in ((2, 3.0, 1.85), (2, 5.0, 1.85), (2, 8.0, 1.85), (1, 5.0, 2.12), (1, 8.0, 1.97)):
        table, ends = drifting(rng, np.full(8000, kind), np.full(8000, size))
        squares = (table.mean(axis=0) - ends) ** 2 / (variance_of_mean(table) + variance_of_drift(table))
        # of steady drifts it was 2.0 to 2.1 and is 1.63 to 1.73, of walks 2.25 and 2.03 and is 1.99 and 1.88; 8000
        # tell it to 0.02
        assert np.sqrt(np.mean(squares)) < most, (kind, size)


def variance_by_integration(means: Array) -> float:
    """Variance of the mean of 20 parts against the end by what they drift, from full covariances, finely summed."""
    parts, fine, sizes = 20, 50, np.geomspace(0.01, 1e4, 400)
    instants = np.arange(1.0, parts * fine + 1) / fine
    walk, away = np.minimum.outer(instants, instants), np.minimum.outer(instants, instants[-1:])
    middle = np.arange(parts) + 0.5
    kinds = [
        (  # covariance of the parts, with the way from the mean to the end, and variance of that way
            walk.reshape(parts, fine, parts, fine).mean(axis=(1, 3)),
            (away[:, 0] - walk.mean(axis=1)).reshape(parts, fine).mean(axis=1),
            away[-1, 0] - 2 * away.mean() + walk.mean(),
        ),
        (np.outer(middle, middle), middle * parts / 2, parts**2 / 4),
    ]
    free = null_space(np.ones((1, parts)))  # of the level, which says nothing
    seen = free.T @ means
    prior = 1 / (sizes / 10 + 10 / sizes)
    whole, drift = 0.9 * (seen @ seen) ** (-(parts - 1) / 2), 0.0
    for (covariance, with_way, of_way), steady in zip(kinds, (False, True), strict=True):
        for size, probability in zip(sizes, 0.05 * prior / prior.sum(), strict=True):
            scale = size**2 / parts / of_way
            of_seen = np.eye(parts - 1) + scale * free.T @ covariance @ free
            solved = np.linalg.solve(of_seen, seen)
            likely = probability * np.linalg.det(of_seen) ** -0.5 * (seen @ solved) ** (-(parts - 1) / 2)
            noise = seen @ solved / (parts - 3)
            variance = noise * scale * of_way
            if steady:  # what is seen of it is how far it leads
                known = scale * free.T @ with_way
                variance += (known @ solved) ** 2 - noise * known @ np.linalg.solve(of_seen, known)
            whole, drift = whole + likely, drift + likely * variance
    return drift / whole


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_the_variance_by_drift_is_its_mean_over_all_that_is_possible(kind: int, rng) -> None:
    table, _ = drifting(rng, np.full(3, kind), np.array([2.0, 5.0, 20.0]))
    expected = [variance_by_integration(means) for means in batch_means(table).T]
    np.testing.assert_allclose(variance_of_drift(table), expected, rtol=0.02)
    assert (variance_of_drift(np.full((100, 2), 0.1)) < 1e-30).all()


def test_natural_zeros_that_were_left_in_the_outputs_are_told(balance: BalanceMatrix, rng) -> None:
    """Outputs said to be less their zero that lie at the natural zeros; and no word of such as are less it."""
    natural = rng.uniform(0.1, 0.3, 6)
    known = replace(balance, natural_zero=natural)
    native = 0.05 * swinging(2000, rng)
    own = known.loads(natural[None, :]).loads[0]
    expected = np.abs(in_direct(balance, own[None, :])[0])

    def reduced(outputs: Array) -> Loads:
        return reduce_outputs(recorded(outputs), known, zero=Zero([], model_on=False))

    with pytest.warns(DataQualityWarning, match="none was taken off"):
        left = reduced(balance.outputs(native) + natural)
    told = {doubt.component: doubt.effect for doubt in left.doubts if doubt.kind == "zero"}
    assert told == pytest.approx(dict(zip(left.components, expected, strict=True)))
    assert dict(left.recording.zeros_left) == pytest.approx(told)
    off = reduced(balance.outputs(native))
    assert not [doubt for doubt in off.doubts if doubt.kind == "zero"]
    # in the difference to a wind-off recording with the same zeros nothing of them is left
    calm = recorded(np.tile(natural, (2000, 1)) + rng.normal(0, NOISE, (2000, 6)), name="calm")
    run = recorded(balance.outputs(native) + natural)
    less = reduce_outputs(run, known, zero=Zero([], model_on=False), tare=[calm])
    assert not [doubt for doubt in less.doubts if doubt.kind == "zero"]
    assert not less.recording.zeros_left
