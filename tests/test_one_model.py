"""One model of the dynamics for any number of components: those that are not coupled are a case of those that are.

The same balance is given as masses on springs of their own and by diagonal matrices; both must say the same.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from aerobalance.dynamics.balance_dynamics import BalanceDynamics
from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.independent import NO_DYNAMICS, IndependentDynamics, dynamics_of
from aerobalance.dynamics.modal import Mode
from aerobalance.dynamics.single import Dynamics
from aerobalance.estimation.force import estimate_force
from aerobalance.estimation.force_record import force_record
from aerobalance.estimation.live.live_force import LiveForce
from aerobalance.recording.channel import Array, Channel
from aerobalance.recording.errors import DataQualityWarning
from aerobalance.recording.recording import Recording
from aerobalance.uncertainty.planning import plan
from helpers.coupled_pair import pair

FREQUENCY = np.geomspace(1.0, 2000.0, 60)
KNOWN = np.diag([0.3**2, 4e4**2, 20.0**2, 1e-5**2])
PARTS = (
    Dynamics("NF", 60.0, 6e6, 400.0, covariance=KNOWN),
    Dynamics("AF", 177.87, 3.093e7, 828.21, delay=1e-4, covariance=KNOWN),
)
FURTHER = (Mode(210.0, 0.01, 0.08), Mode(400.0, 0.02, -0.03))
ROUNDING = 1e-11  # of numbers that some hundred products and a solution of a few equations lead to


def apart() -> IndependentDynamics:
    found = dynamics_of(PARTS)
    assert isinstance(found, IndependentDynamics)
    return found


def both() -> tuple[BalanceDynamics, BalanceDynamics]:
    return apart(), CoupledDynamics.of_components(PARTS)


def bent() -> CoupledDynamics:
    """NF and PM with one internal coordinate."""
    w, units = 2 * np.pi * np.array([60.0, 150.0, 260.0]), np.outer([1000.0, 50.0, 1.0], 1 / np.array([1000.0, 50, 1]))
    inertia = np.array([[1.0, 0.2, 0.3], [0.3, 1.0, 0.1], [0.2, 0.2, 1.0]]) / np.outer(w, w)
    damping = np.array([[0.03, 0.002, 0.001], [0.004, 0.05, 0.001], [0.002, 0.003, 0.02]]) / np.sqrt(np.outer(w, w))
    return CoupledDynamics(("NF", "PM"), inertia * units, damping * units)


def test_responses_are_diagonal_and_the_same() -> None:
    one, other = both()
    for name in ("response", "inverse_response"):
        np.testing.assert_allclose(getattr(one, name)(FREQUENCY), getattr(other, name)(FREQUENCY), rtol=ROUNDING)
    assert one.components == other.components == ("NF", "AF")
    for mine, theirs in zip(one.quadratic, other.quadratic, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=ROUNDING)
    np.testing.assert_allclose(np.sort_complex(one.poles), np.sort_complex(other.poles), rtol=ROUNDING)
    assert one.zeros.size == other.zeros.size == 0
    ends = [sorted(mode.natural_frequency for mode in model.modes) for model in (one, other)]
    assert ends[0] == pytest.approx(ends[1], rel=ROUNDING)


def test_uncertain_parameters_do_the_same_to_the_forces() -> None:
    """Mass, stiffness and damping on the one side, elements of A and D on the other, with the covariance of these."""
    spread = []
    for model in both():
        parts = list(model.force_slopes(FREQUENCY))
        spread.append(
            [np.einsum("mpk,pq,mql->mkl", one.slopes, one.covariance, one.slopes.conj()).real for one in parts]
        )
        n = len(model.components)
        own = model.row_covariance[:, : 2 * n, : 2 * n]
        spread[-1].append(own)
    for mine, theirs in zip(*spread, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())


def test_the_rows_are_apart_already() -> None:
    for model in both():
        for place, name in enumerate(model.components):
            channel = model.decoupled(name, noise=np.diag([4.0, 9.0]))
            assert channel.alone
            assert channel.component == name
            part = PARTS[place]
            np.testing.assert_allclose(channel.row[place], [1.0, *part.quadratic], rtol=ROUNDING)
            np.testing.assert_allclose(channel.dynamics.response(FREQUENCY), part.response(FREQUENCY), rtol=ROUNDING)
            fractions = channel.fractions
            assert fractions.direct.tolist() == np.eye(2)[place].tolist()
            assert not fractions.by_value.any()
            own = model.own_response(name)
            np.testing.assert_allclose(own.response(FREQUENCY), part.response(FREQUENCY), rtol=1e-9)


def test_parameters_can_be_changed() -> None:
    for model in both():
        again = model.with_parameters(model.parameter_values)
        np.testing.assert_allclose(again.response(FREQUENCY), model.response(FREQUENCY), rtol=ROUNDING)
        assert not again.covariance.any()
        assert not model.exact.covariance.any()
        assert model.covariance.any()
        assert model.calibration is None


def test_what_belongs_together_is_worked_out_together() -> None:
    one, other = both()
    assert [block.components for block in one.blocks] == [("NF",), ("AF",)]
    assert other.blocks == (other,)
    assert one.estimable(["AF", "pitch"]) == ("AF",)
    assert other.estimable(["AF", "pitch"]) == ()
    assert one.block_of("AF").components == ("AF",)
    assert NO_DYNAMICS.blocks == NO_DYNAMICS.components == ()
    with pytest.raises(ValueError, match="NF, AF are not coupled"):
        LiveForce(one, rate=4000.0)


def test_what_an_identification_returns_is_taken_for_its_dynamics() -> None:
    found = SimpleNamespace(dynamics=PARTS[1])
    assert dynamics_of(found)["AF"] is PARTS[1]
    assert LiveForce(found, rate=4000.0).components == ("AF",)
    one, other = (plan(given, rate=4000.0, noise=1.0)["AF"].table for given in (found, PARTS[1]))
    assert [row.total for row in one] == [row.total for row in other]


def test_the_mass_is_known_along_one_axis_or_as_a_rigid_body() -> None:
    one, other = both()
    assert one.moved_by.tolist() == [True, False, False, False, False, True]
    assert one.mass_rows[:, [0, 5]].tolist() == [[60.0, 0.0], [0.0, 177.87]]
    assert one.delays.tolist() == [0.0, 1e-4]
    assert not other.moved_by.any()
    assert not other.mass_rows.any()
    known = pair()
    assert known.moved_by.all()
    assert known.mass is not None
    np.testing.assert_array_equal(known.mass_rows, known.mass.matrix[:2])


def test_zeros_are_where_no_component_shows_anything() -> None:
    part, coupled = PARTS[1].with_modes(*FURTHER), bent()

    def shown(s: complex) -> float:
        return float(abs(part.response(np.array([s / 2j / np.pi]))[0]))

    def shown_of_coupled(s: complex) -> float:
        return float(abs(np.linalg.det(np.linalg.inv(coupled.equation(np.array([s])))[0, :2, :2])))

    for model, size, count in ((dynamics_of(part), shown, 4), (coupled, shown_of_coupled, 2)):
        assert model.zeros.size == count
        for zero in model.zeros:
            # a simple zero: what is shown falls with the distance from it
            assert size(zero * (1 + 1e-7)) < 1e-4 * size(zero * 1.01)


def test_polynomials_are_those_of_the_response() -> None:
    part = PARTS[1].with_modes(*FURTHER)
    above, below = part.polynomials
    assert (above.size, below.size) == (5, 7)
    s = 2j * np.pi * FREQUENCY
    found = np.polynomial.polynomial.polyval(s, above) / np.polynomial.polynomial.polyval(s, below)
    # numerator and denominator are sums of terms of both signs: near a resonance of damping ratio 0.004
    np.testing.assert_allclose(found, part.response(FREQUENCY), rtol=1e-9)


@pytest.mark.parametrize("which", ["further modes", "internal coordinate"])
def test_slopes_of_the_forces_are_those_of_differences(which: str) -> None:
    model = dynamics_of(PARTS[1].with_modes(*FURTHER)) if which == "further modes" else bent()
    values, response = model.parameter_values, model.response(FREQUENCY)
    for place, part in enumerate(model.force_slopes(FREQUENCY)):
        rows = np.arange(values.size)
        if which == "internal coordinate":
            rows = model.decoupled(model.components[place], noise=np.eye(2)).rows
        assert part.slopes.shape[1] == rows.size
        for number, row in enumerate(rows):
            step = np.zeros(values.size)
            step[row] = 1e-6 * abs(values[row])
            up, down = (model.with_parameters(values + sign * step).inverse_response(FREQUENCY) for sign in (1, -1))
            found = ((up - down) @ response)[:, place] / (2 * step[row])
            scale = np.abs(part.slopes[:, number]).max() + 1e-300
            # central differences: their square, and rounding of 1e-16 over 1e-6 with what a resonance makes of it
            np.testing.assert_allclose(found / scale, part.slopes[:, number] / scale, atol=1e-6)


def test_a_live_force_takes_one_coupled_component_with_an_internal_coordinate(rng: np.random.Generator) -> None:
    inertia, damping = np.array([[4e-6, 1e-6], [2e-6, 3e-6]]), np.array([[2e-5, 0.0], [0.0, 1e-5]])
    live = LiveForce(CoupledDynamics(("AF",), inertia, damping), rate=4000.0)
    assert live.noise is None  # it is not asked for: nothing is weighed by it
    blocks = np.split(100.0 + rng.normal(size=8000), 20)
    force = np.concatenate([live.push({"AF": block})["AF"].force for block in blocks])[-2000:]
    assert force.size == 2000
    # readings with noise of 1 N: six standard deviations of their mean
    assert abs(float(force.mean()) - 100.0) < 6 / np.sqrt(2000)


def recording(rng: np.random.Generator) -> Recording:
    count, rate = 3000, 4000.0
    time = np.arange(count) / rate
    force = 100 * np.sin(2 * np.pi * 12 * time)
    channels = {
        part.component: Channel(
            part.component, part.balance_load(force, interval=1 / rate) + rng.normal(size=count), "N"
        )
        for part in PARTS
    }
    return Recording.from_columns(time, channels, name="run")


def test_records_are_the_same(rng: np.random.Generator) -> None:
    given = recording(rng)
    records = [force_record(given, model) for model in both()]
    for record in records:
        assert not record.is_coupled
        assert not record.has_gaps
        assert [channel.name for channel in record.channels] == ["NF", "AF"]
        assert not record.from_ground.any()
        assert record.is_uncertain("AF")
    one, other = records
    np.testing.assert_array_equal(one.loads, other.loads)
    np.testing.assert_array_equal(one.noise, other.noise)
    for place in (0, 1):
        readings = [record.reading(place, on_clock_of=place, filled=record.loads) for record in records]
        np.testing.assert_array_equal(*readings)
        np.testing.assert_array_equal(readings[0], one.component_record(("NF", "AF")[place]).reading().values)
    felt = rng.normal(size=one.loads.shape)
    for name, place in (("NF", 0), ("AF", 1)):
        for record in records:
            np.testing.assert_array_equal(record.component_record(name).reading_of(felt), felt[:, place])


def test_a_record_on_a_moving_ground_knows_what_that_puts_on_the_loads(rng: np.random.Generator) -> None:
    given = recording(rng)
    count = given.samples
    channels = {name: replace(channel, delay=3e-4) for name, channel in given.channels.items()}
    channels["ground_acceleration"] = Channel("ground_acceleration", rng.normal(size=count), "m/s^2", noise=0.1)
    record = force_record(replace(given, channels=channels), PARTS[1])
    own = record.component_record("AF")
    assert record.motion_covariance.shape == (1, 1)
    assert np.sqrt(record.motion_covariance[0, 0]) == pytest.approx(own.input_noise)
    assert own.input_noise > 0
    # on the clock, and moved by the load's delay for the reading: both are shifted by parts of a sample
    inner = slice(200, -200)
    read = record.reading(0, on_clock_of=0, filled=record.loads)
    left: Array = (read - own.reading().values)[inner]
    # What moves before the record begins is not known: either may leave an oscillation that is free, as the estimator
    # takes it. The rest is small beside the noise of the reading, 1 N, where the ground puts hundreds on it.
    decay = PARTS[1].free_decay(np.arange(left.size) * record.interval)
    free = np.column_stack([decay, np.gradient(decay)])
    left = left - free @ np.linalg.lstsq(free, left, rcond=None)[0]
    assert float(np.std(own.from_ground[inner])) > 100.0
    assert float(np.std(left)) < 0.1


def test_a_plan_is_the_same_for_both() -> None:
    noise = {"NF": 1.0, "AF": 2.0}
    plans = [
        plan(model, rate=4000.0, noise=noise, force={"NF": 50.0, "AF": 80.0}, bandwidths=[40.0, 90.0])
        for model in both()
    ]
    for name in noise:
        one, other = ([row.total for row in found[name].table] for found in plans)
        # the quadrature has its points about the poles of one component or of both
        assert one == pytest.approx(other, rel=1e-6)


def test_live_forces_are_the_same(rng: np.random.Generator) -> None:
    given = recording(rng)
    single, coupled = (
        LiveForce(model, rate=given.rate, noise=np.eye(1))
        for model in (PARTS[1], CoupledDynamics.of_components(PARTS[1:]))
    )
    block = {"AF": given.channel("AF").values}
    one, other = (live.push(block)["AF"].force for live in (single, coupled))
    assert one.size > 500
    np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6 * np.abs(one).max())


def test_few_steps_of_a_converter_are_counted_in_both(rng: np.random.Generator) -> None:
    part, count, rate = PARTS[1], 3000, 1600.0
    load = part.balance_load(2 * np.cumsum(rng.normal(size=count)), interval=1 / rate) + 0.05 * rng.normal(size=count)
    channel = Channel("AF", 4.0 * np.round(load / 4.0), "N")
    given = Recording.from_columns(np.arange(count) / rate, {"AF": channel}, name="run")
    found = []
    for model in (part, CoupledDynamics.of_components([part])):
        with pytest.warns(DataQualityWarning, match="steps of 4 N"):
            force = estimate_force(given, model)["AF"]
        assert [doubt.kind for doubt in force.doubts] == ["resolution"]
        found.append(force.budget["resolution of the channel"])
    # the same readings and models that are the same to rounding, which the learning of spectra magnifies
    assert found[0] == pytest.approx(found[1], rel=1e-6)
