"""The balance matrix: round trips, the obvious implementation beside the compiled one, formats of loads."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from hypothesis import given, settings
from hypothesis import strategies as st

from aerobalance.balance import _term_kernels as kernels
from aerobalance.balance import inversion
from aerobalance.balance.inversion import inverted
from aerobalance.balance.load_formats import FORMS, Form, Geometry, between_forms, role_of, to_direct
from aerobalance.balance.load_variance import load_variances
from aerobalance.balance.matrix import BalanceMatrix
from aerobalance.balance.terms import KINDS, codes, terms_of
from aerobalance.recording.components import COMPONENTS
from aerobalance.simulation.calibration_stand import CAPACITIES, random_balance

MODELS = ("linear", "quadratic", "abs", "27", "96")
seeds = st.integers(0, 2**63 - 1)

VALUES = {
    "{a}": lambda a, b: a,
    "|{a}|": lambda a, b: np.abs(a),
    "{a}*{a}": lambda a, b: a**2,
    "{a}*|{a}|": lambda a, b: a * np.abs(a),
    "{a}*{b}": lambda a, b: a * b,
    "|{a}*{b}|": lambda a, b: np.abs(a * b),
    "{a}*|{b}|": lambda a, b: a * np.abs(b),
    "|{a}|*{b}": lambda a, b: np.abs(a) * b,
    "{a}*{a}*{a}": lambda a, b: a**3,
    "|{a}*{a}*{a}|": lambda a, b: np.abs(a) ** 3,
}


def polynomial(matrix: BalanceMatrix, x: np.ndarray) -> np.ndarray:
    """The polynomials, written out with numpy: x and result scaled, shape (n, c)."""
    y = np.zeros_like(x)
    for term, row in zip(matrix.terms, matrix.coefficients, strict=True):
        y += VALUES[KINDS[term.kind]](x[:, term.first], x[:, term.second])[:, None] * row
    return y


def some_loads(rng: np.random.Generator, count: int = 40) -> np.ndarray:
    """Loads anywhere in the range, with exact zeros and corners among them."""
    loads = rng.uniform(-1, 1, (count, 6))
    loads[rng.random(loads.shape) < 0.2] = 0.0
    corner = rng.random(loads.shape) < 0.1
    loads[corner] = np.sign(loads[corner])
    return loads * CAPACITIES


@pytest.mark.parametrize("way", ["iterative", "non-iterative"])
@pytest.mark.parametrize("model", MODELS)
@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_loads_come_back(model: str, way: str, seed: int) -> None:
    matrix = replace(random_balance(seed, model=model), way=way)
    loads = some_loads(np.random.default_rng(seed))
    solution = matrix.loads(matrix.outputs(loads))
    assert (solution.steps > 0).all()
    # the requirement: 1e-10 of range
    np.testing.assert_allclose(solution.loads / CAPACITIES, loads / CAPACITIES, rtol=0, atol=1e-10)


@pytest.mark.parametrize("way", ["iterative", "non-iterative"])
@pytest.mark.parametrize("model", MODELS)
@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_outputs_come_back(model: str, way: str, seed: int) -> None:
    matrix = replace(random_balance(seed, model=model), way=way)
    outputs = matrix.outputs(some_loads(np.random.default_rng(seed)))
    back = matrix.outputs(matrix.loads(outputs).loads)
    np.testing.assert_allclose(back / matrix.output_scale, outputs / matrix.output_scale, rtol=0, atol=1e-10)


FORMATS = {
    "force": ("N1", "N2", "S1", "S2", "RM", "AF"),
    "moment": ("PM1", "PM2", "YM1", "YM2", "RM", "AF"),
    "direct": COMPONENTS,
    "moment, in another order": ("Aft_Pitch", "Aft_Yaw", "Fwd_Pitch", "Fwd_Yaw", "Ax", "Roll"),
}


@pytest.mark.parametrize("format_", FORMATS)
@pytest.mark.parametrize("model", MODELS)
@settings(max_examples=10, deadline=None)
@given(seed=seeds, arms=st.tuples(*[st.floats(0.02, 1.0)] * 4))
def test_round_trip_through_direct_read(
    model: str, format_: str, seed: int, arms: tuple[float, float, float, float]
) -> None:
    matrix = replace(random_balance(seed, model=model), components=FORMATS[format_], geometry=Geometry(*arms))
    loads = some_loads(np.random.default_rng(seed))
    assert matrix.direct is not None
    direct = loads @ matrix.direct.T
    native = np.linalg.solve(matrix.direct, direct.T).T
    back = matrix.loads(matrix.outputs(native)).loads
    # arms of 0.02 to 1 m make the transformation's condition number 50 at most beside that of the two scales (< 600);
    # 3e4 roundings of 1.1e-16 are 3e-12, well within the requirement
    np.testing.assert_allclose(back / CAPACITIES, loads / CAPACITIES, rtol=0, atol=1e-10)


def test_forces_and_moments_about_the_centre() -> None:
    arms = Geometry(0.12, 0.15, 0.1, 0.08)
    force = to_direct(FORMATS["force"], arms)
    moment = to_direct(FORMATS["moment"], arms)
    assert force is not None
    assert moment is not None
    # 100 N on the forward normal gauge, 40 N on the aft one: NF = 140 N, PM = 0.12 * 100 - 0.15 * 40 N*m
    np.testing.assert_allclose(force @ [100, 40, 0, 0, 0, 0], [140, 6, 0, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(force @ [0, 0, 10, 20, 3, 5], [0, 0, 30, 1 - 1.6, 3, 5], atol=1e-12)
    # NF = 140, PM = 6: bending moments PM - x1 NF = -10.8 forward and PM + x2 NF = 27 aft
    np.testing.assert_allclose(moment @ [6 - 0.12 * 140, 6 + 0.15 * 140, 0, 0, 0, 0], [140, 6, 0, 0, 0, 0], atol=1e-9)
    np.testing.assert_allclose(
        moment @ [0, 0, -0.6 - 0.1 * 30, -0.6 + 0.08 * 30, 0, 0], [0, 0, 30, -0.6, 0, 0], atol=1e-9
    )
    np.testing.assert_array_equal(to_direct(COMPONENTS, None), np.eye(6))


def test_formats_that_are_not_known() -> None:
    assert to_direct(FORMATS["force"], None) is None
    assert to_direct(("N1", "N2", "S1", "S2", "RM"), Geometry(0.1, 0.1, 0.1, 0.1)) is None
    assert to_direct(("N1", "N2", "S1", "S2", "RM", "thrust"), Geometry(0.1, 0.1, 0.1, 0.1)) is None
    with pytest.raises(ValueError, match="without the distances of the gauges"):
        between_forms(FORMATS["force"], "moment", None)


@pytest.mark.parametrize("given", FORMATS)
@pytest.mark.parametrize("wanted", ["force", "moment", "direct"])
def test_all_forms_go_into_each_other(given: str, wanted: Form) -> None:
    arms = Geometry(0.12, 0.15, 0.1, 0.08)
    first, second = (to_direct(names, arms) for names in (FORMATS[given], FORMS[wanted]))
    assert first is not None
    assert second is not None
    # the same forces and moments about the centre, whichever way they are written
    np.testing.assert_allclose(second @ between_forms(FORMATS[given], wanted, arms), first, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "role"),
    [("Aft Pitch", "aft pitch"), ("Fwd_Yaw", "forward yaw"), ("Axial", "AF"), ("Mx", "RM"), ("Y1", "forward side")],
)
def test_names_of_loads(name: str, role: str) -> None:
    assert role_of(name) == role


@pytest.mark.parametrize(
    ("model", "count"), [("linear", 6), ("abs", 12), ("quadratic", 27), ("27", 27), ("96", 96), ("auto", 96)]
)
def test_counts_of_terms(model: str, count: int) -> None:
    # AIAA R-091: 27 = 6 + 6 + 15, 96 = 4*6 + 4*15 + 2*6
    terms = terms_of(model, 6)
    assert len(terms) == len(set(terms)) == count


@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_terms_beside_plain_numpy(seed: int) -> None:
    matrix = random_balance(seed)
    x = some_loads(np.random.default_rng(seed)) / CAPACITIES
    # 96 terms of size one and less, summed: 96 roundings
    tolerance = 96 * np.finfo(float).eps
    np.testing.assert_allclose(
        matrix.outputs(x * CAPACITIES) / matrix.output_scale, polynomial(matrix, x), rtol=0, atol=tolerance
    )
    H = np.column_stack([VALUES[KINDS[t.kind]](x[:, t.first], x[:, t.second]) for t in matrix.terms])
    np.testing.assert_allclose(kernels.design(*codes(matrix.terms), x), H, rtol=4 * np.finfo(float).eps)


def test_inverse_beside_a_general_solver(rng) -> None:
    matrix = random_balance(int(rng.integers(2**31)))
    outputs = matrix.outputs(some_loads(rng, 10))
    loads = matrix.loads(outputs).loads / CAPACITIES
    for y, x in zip(outputs / matrix.output_scale, loads, strict=True):
        found = scipy.optimize.root(lambda v, y=y: polynomial(matrix, v[None])[0] - y, np.zeros(6), tol=1e-13)
        # MINPACK ends at steps of 1e-13 of the solution
        np.testing.assert_allclose(x, found.x, rtol=0, atol=1.1 * inversion.TOLERANCE)


def test_jacobian_beside_differences(rng) -> None:
    matrix = random_balance(int(rng.integers(2**31)))
    x = rng.uniform(0.1, 1, (5, 6)) * rng.choice([-1, 1], (5, 6))  # away from the kinks
    J = kernels.jacobians(*codes(matrix.terms), matrix.coefficients, x)
    step = 1e-6
    for k in range(6):
        shift = step * np.eye(6)[k]
        difference = (polynomial(matrix, x + shift) - polynomial(matrix, x - shift)) / (2 * step)
        # rounding eps / step = 2e-10; the third derivatives (0.01) times step^2 are nothing beside it
        np.testing.assert_allclose(J[:, :, k], difference, rtol=0, atol=2e-9)


@pytest.mark.parametrize("model", MODELS)
def test_kernels_without_compilation(model: str, monkeypatch: pytest.MonkeyPatch, rng) -> None:
    matrix = random_balance(int(rng.integers(2**31)), model=model)
    x = some_loads(rng, 6) / CAPACITIES
    terms, C = codes(matrix.terms), np.ascontiguousarray(matrix.coefficients)
    y = np.vstack([polynomial(matrix, x), np.full(6, np.nan)])
    compiled = kernels.design(*terms, x), kernels.jacobians(*terms, C, x), *inverted(*terms_and(matrix), y)
    for name in ("term", "forward", "design", "jacobians", "subtract", "sizes", "note", "move", "invert"):
        monkeypatch.setattr(kernels, name, getattr(kernels, name).py_func)
    plain = kernels.design(*terms, x), kernels.jacobians(*terms, C, x), *inverted(*terms_and(matrix), y)
    # the same operations, but the compiler may contract a multiplication and an addition into one
    for one, other in zip(compiled[:2], plain[:2], strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=200 * np.finfo(float).eps)
    np.testing.assert_allclose(compiled[2], plain[2], rtol=0, atol=2 * inversion.TOLERANCE)
    assert (compiled[3][:-1] > 0).all()
    assert compiled[3][-1] == plain[3][-1] == 0
    assert np.isnan(compiled[2][-1]).all()


def terms_and(matrix: BalanceMatrix):
    """The polynomials as `inverted` takes them."""
    return codes(matrix.terms), matrix.coefficients, matrix.linear


@pytest.mark.parametrize("model", MODELS)
def test_block_iteration_beside_newton_sample_by_sample(model: str, rng) -> None:
    matrix = random_balance(int(rng.integers(2**31)), model=model)
    y = polynomial(matrix, some_loads(rng, 300) / CAPACITIES)
    y[[3, 140], 2] = np.nan
    found, steps = inverted(*terms_and(matrix), y)
    present = np.isfinite(y).all(axis=1)
    expected, _ = inversion._by_newton(*terms_and(matrix)[:2], np.linalg.inv(matrix.linear), y[present])
    # Newton's last step of 1e-12 leaves an error of its square
    np.testing.assert_allclose(found[present], expected, rtol=0, atol=1.1 * inversion.TOLERANCE)
    np.testing.assert_array_equal(steps > 0, present)
    # what is beside a sample, and where a block ends, does not matter; a product of matrices may add in another order
    rounding = 6 * np.finfo(float).eps if model == "linear" else 0.0
    for part in (slice(0, 1), slice(5, 20), slice(100, 300)):
        again = inverted(*terms_and(matrix), y[part])[0]
        np.testing.assert_allclose(again, found[part], rtol=0, atol=rounding)


@pytest.mark.parametrize(("count", "model"), [(1, "96"), (4, "quadratic"), (6, "96"), (8, "quadratic"), (8, "96")])
def test_more_and_less_than_six_components_and_samples_that_need_more_steps(count: int, model: str, rng) -> None:
    """Every ninth sample is so large that its terms bend ten times as much as those of the others."""
    terms = terms_of(model, count)
    C = np.where([[term.kind == 0] for term in terms], 0.0, rng.normal(0, 0.01, (len(terms), count)))
    C[:count] += np.eye(count)
    x = rng.uniform(-0.3, 0.3, (1500, count))
    x[::9] *= 6.0
    y = kernels.design(*codes(terms), x) @ C
    found, steps = inverted(codes(terms), C, C[:count].T, y)
    np.testing.assert_allclose(found, x, rtol=0, atol=1e-10)
    # of 800 draws of 1500 samples five had one whose errors shrink by turns, so that the last steps say too little
    assert np.count_nonzero(np.abs(found - x).max(axis=1) > 1.1 * inversion.TOLERANCE) <= 1
    assert (steps > 0).all()
    assert count == 1 or np.median(steps[::9]) > np.median(steps[1::9])
    again, steps_again = inverted(codes(terms), C, C[:count].T, y[700:950])
    # those that Newton's method finds are in products of matrices, which may add in another order
    np.testing.assert_allclose(again, found[700:950], rtol=0, atol=inversion.LAST_STEP)
    np.testing.assert_array_equal(steps_again, steps[700:950])


def test_far_from_linear_newton_goes_on() -> None:
    # r = F - 0.2 F^2: at r = 1.2 the plain iteration shrinks an error by 0.4 F = 0.8 only, F = 2
    matrix = one_component(terms_of("quadratic", 1), [1.0, -0.2])
    solution = matrix.loads(np.array([[1.2], [0.1]]))
    # slope 1 - 0.4 F = 0.2: rounding of 1.2 comes back five times
    np.testing.assert_allclose(solution.loads[:, 0], [2.0, 5 * (1 - np.sqrt(0.92)) / 2], rtol=1e-11)
    assert solution.steps[0] < inversion.NEWTON_STEPS


def test_loads_without_solution_are_missing() -> None:
    # r = F - F^2 is at most 1/4: there is no load for an output of 1/2
    terms = terms_of("quadratic", 1)
    matrix = one_component(terms, [1.0, -1.0])
    solution = matrix.loads(np.array([[0.5], [0.2], [np.nan]]))
    assert np.isnan(solution.loads[[0, 2], 0]).all()
    assert list(solution.steps[[0, 2]]) == [0, 0]
    # F = (1 - sqrt(1 - 0.8)) / 2, the root that belongs to small loads
    np.testing.assert_allclose(solution.loads[1, 0], (1 - np.sqrt(0.2)) / 2, rtol=1e-12)


def test_contraction_in_closed_form() -> None:
    # r = F - F^2: I - J = 2 F
    matrix = one_component(terms_of("quadratic", 1), [1.0, -1.0])
    np.testing.assert_allclose(matrix.contraction(np.array([[0.1], [-0.3], [0.6]])), [0.2, 0.6, 1.2], rtol=1e-14)


@pytest.mark.parametrize("way", ["iterative", "non-iterative"])
def test_sensitivity_beside_differences(way: str, rng) -> None:
    matrix = replace(random_balance(int(rng.integers(2**31))), way=way)
    loads = rng.uniform(0.1, 1, (3, 6)) * CAPACITIES
    outputs, step = matrix.outputs(loads), 1e-3
    for k in range(6):
        shift = step * np.eye(6)[k] * matrix.output_scale
        change = (matrix.loads(outputs + shift).loads - matrix.loads(outputs - shift).loads) / (2 * shift[k])
        expected = matrix.sensitivity(loads)[:, :, k]
        scale = CAPACITIES / matrix.output_scale[k]
        # the loads are found to 1e-10 (4e-11 in 4000 draws), over 1e-3; the third derivative makes 1e-8
        np.testing.assert_allclose(change / scale, expected / scale, rtol=0, atol=2e-7)


def test_output_of_many_samples_is_that_of_few(monkeypatch: pytest.MonkeyPatch, rng) -> None:
    matrix = random_balance(int(rng.integers(2**31)))
    loads = some_loads(rng, 23)
    whole, covariance = matrix.outputs(loads), matrix.load_covariance(loads)
    monkeypatch.setattr("aerobalance.balance.matrix.CHUNK", 5)
    np.testing.assert_allclose(matrix.outputs(loads), whole, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(matrix.load_covariance(loads), covariance)
    assert matrix.outputs(loads[:0]).shape == (0, 6)
    assert matrix.load_covariance(loads[:0]).shape == (0, 6, 6)


@pytest.mark.parametrize(("way", "curved"), [("iterative", 1.0), ("iterative", 60.0), ("non-iterative", 1.0)])
def test_variances_by_signs_are_those_of_the_covariance(way, curved, rng) -> None:
    """Of a matrix in all terms, with loads of all signs and of none, and where rows have to change places."""
    given = random_balance(int(rng.integers(2**31)), model="96")
    plain = [term.kind == 0 for term in given.terms]
    root = rng.normal(size=(6, len(given.terms), len(given.terms))) * 1e-4
    matrix = replace(
        given,
        way=way,
        coefficients=given.coefficients * np.where(plain, 1.0, curved)[:, None],
        covariance=root @ root.transpose(0, 2, 1),
        residual_deviation=rng.uniform(1e-4, 2e-4, 6),
        residual_correlation=np.eye(6) + 0.3 * (np.eye(6, k=1) + np.eye(6, k=-1)),
    )
    loads, transform = some_loads(rng, 700), rng.normal(size=(4, 6))
    loads[::50, 2] = 0.0
    expected = np.einsum("ij,njk,ik->ni", transform, matrix.load_covariance(loads), transform)
    found = load_variances(matrix, loads, transform=transform)
    # rounding, and twice that of the inverse of the derivatives; without rows that change places it has no limit
    bad = np.linalg.cond(matrix.sensitivity(loads) * matrix.output_scale / matrix.load_scale[:, None])
    assert np.max(np.abs(found / expected - 1) / bad[:, None]) < 1e-12
    assert curved == 1.0 or bad.max() > 100
    assert load_variances(matrix, loads[:0], transform=transform).shape == (0, 4)


def one_component(terms, coefficients) -> BalanceMatrix:
    return BalanceMatrix(
        components=("AF",),
        gauges=("AF",),
        way="iterative",
        terms=terms,
        coefficients=np.array(coefficients)[:, None],
        load_scale=np.ones(1),
        output_scale=np.ones(1),
        covariance=np.zeros((1, len(terms), len(terms))),
        residual_deviation=np.zeros(1),
        residual_correlation=np.eye(1),
        degrees_of_freedom=np.zeros(1, dtype=np.intp),
        calibrated=np.array([[-1.0], [1.0]]),
        natural_zero=None,
        moments=np.zeros(1, dtype=bool),
    )


def test_paper_form_solves_equation_2(rng) -> None:
    matrix = random_balance(int(rng.integers(2**31)), model="quadratic")
    loads = some_loads(rng, 20)
    form = matrix.paper_form()
    outputs = matrix.outputs(loads)
    right = form.own * outputs + loads @ form.cross.T
    for r, s in itertools.combinations_with_replacement(range(6), 2):
        right += np.outer(loads[:, r] * loads[:, s], form.square[:, r, s])
    # 27 terms over capacity
    np.testing.assert_allclose(right / CAPACITIES, loads / CAPACITIES, rtol=0, atol=100 * np.finfo(float).eps)


def test_paper_form_of_other_terms_is_refused() -> None:
    with pytest.raises(ValueError, match=r"Eq\. \(2\) has linear and quadratic terms only"):
        random_balance(0, model="abs").paper_form()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"coefficients": np.zeros((5, 6))}, "coefficients must have shape"),
        ({"gauges": ("a",)}, "6 components need 6 gauges"),
        ({"load_scale": -CAPACITIES}, "load_scale must be positive"),
        ({"natural_zero": np.zeros(5)}, "natural_zero must have shape"),
        ({"coefficients": np.ones((6, 6))}, "cannot be inverted"),
    ],
)
def test_wrong_matrices_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(random_balance(0, model="linear"), **changes)


def test_wrong_models_and_distances_are_refused() -> None:
    with pytest.raises(ValueError, match="model must be one of linear"):
        terms_of("cubic", 6)
    with pytest.raises(ValueError, match="aft_side must be positive"):
        Geometry(0.1, 0.1, 0.1, 0.0)
