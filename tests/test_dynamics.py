"""The balance as a damped spring: closed forms against integration, transforms and each other."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from aerobalance.dynamics.independent import NO_DYNAMICS, IndependentDynamics
from aerobalance.dynamics.modal import Mode
from aerobalance.dynamics.single import PARAMETERS, Dynamics, extremum_ratio, stiffness_from_damped_frequency
from aerobalance.recording.wording import with_u
from helpers.cable_cut import T128
from helpers.coupled_pair import pair as coupled_pair

RIG = Dynamics("AF", 0.68, 11.43e6, 371.98)
HEAVY = Dynamics("AF", 2.0, 800.0, 160.0)  # damping ratio 2
CRITICAL = Dynamics("AF", 2.0, 800.0, 80.0)  # damping ratio 1


def integrated(dynamics: Dynamics, time: np.ndarray, force, start=(0.0, 0.0)) -> np.ndarray:
    """Balance load AF = k x by an independent integrator of Eq. (8); start is AF and AF' / w0."""
    w0, ratio = np.sqrt(dynamics.stiffness / dynamics.mass), dynamics.damping / dynamics.mass

    def slope(t, state):
        load, rate = state
        return [w0 * rate, w0 * (force(t) - load) - ratio * rate]

    solution = solve_ivp(slope, (time[0], time[-1]), start, t_eval=time, method="DOP853", rtol=1e-11, atol=1e-12)
    return solution.y[0]


@pytest.mark.parametrize("dynamics", [T128, RIG, HEAVY], ids=["6-EB-128-1", "6F-540", "overdamped"])
def test_free_decay_is_the_released_oscillator(dynamics):
    time = np.linspace(0, 5 / dynamics.natural_frequency, 400)
    # 1e-8: the integrator's tolerance of 1e-11 a step over about 500 steps
    assert dynamics.free_decay(time) == pytest.approx(integrated(dynamics, time, lambda t: 0.0, (1.0, 0.0)), abs=1e-8)


@pytest.mark.parametrize("dynamics", [T128, HEAVY], ids=["6-EB-128-1", "overdamped"])
def test_the_rate_of_a_free_decay_is_its_slope(dynamics):
    time = np.linspace(0.1, 5, 400) / dynamics.natural_frequency
    step = 1e-5 / dynamics.natural_frequency
    (mode,) = dynamics.modes
    slope = (mode.free_decay(time + step) - mode.free_decay(time - step)) / (2 * step)
    # central differences: rounding of 1e-16 over 1e-5, and a square of 2 pi 1e-5 over 6
    assert mode.free_decay_rate(time) == pytest.approx(slope, abs=1e-8 * dynamics.angular_frequency)


def test_dynamics_show_their_further_modes():
    shown = repr(T128.with_modes(Mode(171.0, 0.008, 0.1)))
    assert "further mode 171 Hz, damping ratio 0.008, share 0.1" in shown


def test_where_no_dynamics_are_known_there_are_no_parameters():
    assert NO_DYNAMICS.parameter_values.shape == (0,)
    assert NO_DYNAMICS.covariance.shape == (0, 0)
    assert NO_DYNAMICS.with_parameters(np.zeros(0)).parts == {}


def test_dynamics_of_a_moment_have_its_units():
    """The mass of a moment has its lever, kg*m: of N*m the stiffness per metre is N, and the damping N*s."""
    shown = repr(Dynamics("PM", 10.0, 1e6, 50.0))
    assert "mass 10 kg*m\n" in shown
    assert "stiffness 1e+06 N\n" in shown
    assert "damping 50 N*s\n" in shown
    assert "stiffness 1e+06 N/m\n" in repr(Dynamics("NF", 10.0, 1e6, 50.0))


def test_critical_damping_is_the_limit():
    time = np.linspace(0, 1, 200)
    w0 = CRITICAL.angular_frequency
    exact = (1 + w0 * time) * np.exp(-w0 * time)  # double pole
    # The pole is split by 1e-6 w0: the truncation is of second order in 1e-6, the cancellation eps / 1e-6 = 2e-10.
    assert CRITICAL.free_decay(time) == pytest.approx(exact, abs=1e-8)
    assert CRITICAL.damping_ratio == pytest.approx(1.0, rel=1e-12)


def test_load_is_held_before_the_release():
    assert (T128.free_decay([-1.0, -1e-9, 0.0]) == 1.0).all()
    assert (T128.step_response(np.array([-1.0, 0.0])) == 0.0).all()
    assert (T128.step_response(np.array([-1.0, 0.0]), duration=0.01) == 0.0).all()


def test_step_response_is_the_integrated_one():
    time = np.linspace(0, 0.1, 300)
    # 1e-8: the integrator's tolerance of 1e-11 a step over about 500 steps
    assert T128.step_response(time) == pytest.approx(integrated(T128, time, lambda t: 1.0), abs=1e-8)


@pytest.mark.parametrize("duration", [0.003, 0.02])
def test_response_to_a_ramp_is_the_mean_of_step_responses(duration):
    # A ramp is a mean of steps spread over its duration: Gauss quadrature of order 64 over at most 1.3 periods.
    time = np.linspace(0, 0.1, 300)
    nodes, weights = np.polynomial.legendre.leggauss(64)
    for t in time:
        upper = min(t, duration)  # steps that have happened: the kink at the step itself stays outside
        instants = upper * (nodes + 1) / 2
        mean = weights @ T128.step_response(t - instants) * upper / 2 / duration
        assert T128.step_response(np.array([t]), duration=duration)[0] == pytest.approx(mean, abs=1e-10)


def test_extrema_of_the_free_decay_follow_eq_7():
    period = 1 / T128.damped_frequency
    n = np.arange(40)
    extrema = T128.free_decay(n * period / 2)
    expected = (-1.0) ** n * extremum_ratio(T128.damping, T128.mass, period, n)
    assert extrema == pytest.approx(expected, rel=1e-10)
    # and they are extrema: the slope there, over that of the swing, is zero to the accuracy of the difference
    step = 1e-6 * period
    slope = (T128.free_decay(n[1:] * period / 2 + step) - T128.free_decay(n[1:] * period / 2 - step)) / (2 * step)
    assert np.max(np.abs(slope)) < 1e-8 * T128.angular_frequency


def test_damped_frequency_and_stiffness_are_each_others_inverse():
    for dynamics in (T128, RIG):
        found = stiffness_from_damped_frequency(dynamics.damped_frequency, dynamics.mass, dynamics.damping)
        assert found == pytest.approx(dynamics.stiffness, rel=1e-12)
        square = dynamics.angular_frequency**2 - (dynamics.damping / 2 / dynamics.mass) ** 2  # Eq. (19)
        assert dynamics.damped_angular_frequency == pytest.approx(np.sqrt(square), rel=1e-12)


def test_stiffness_from_the_printed_frequency():
    # METHOD: (20) with f = 66.4 gives 3.096e7, to half the last digit.
    assert abs(stiffness_from_damped_frequency(66.4, 177.87, 828.21) - 3.096e7) <= 0.0005e7


def test_response_is_the_transform_of_the_impulse_response():
    for frequency in (10.0, T128.natural_frequency, 200.0):

        def impulse(t):  # of Eq. (8) for AF/F, from the textbook
            w0, wd = T128.angular_frequency, T128.damped_angular_frequency
            return w0**2 / wd * np.exp(-T128.decay_rate * t) * np.sin(wd * t)

        end = 30 / T128.decay_rate
        time = np.arange(0, end, 2e-5)
        real = np.trapezoid(impulse(time) * np.cos(2 * np.pi * frequency * time), time)
        imaginary = -np.trapezoid(impulse(time) * np.sin(2 * np.pi * frequency * time), time)
        # trapezoidal rule: error near w0 h^2 slope / 12 = 6e-6 w0 h of the impulse's first slope
        assert T128.response(frequency) == pytest.approx(complex(real, imaginary), rel=1e-4, abs=1e-4)


def test_response_solves_eq_8():
    f = np.array([0.0, 100.0, 652.5, 900.0])
    w = 2 * np.pi * f
    left = 1 + RIG.damping / RIG.stiffness * 1j * w - RIG.mass / RIG.stiffness * w**2
    assert RIG.response(f) * left == pytest.approx(np.ones(4), abs=1e-12)


def test_amplitude_and_lag_are_eqs_12_and_11():
    f = np.array([30.0, 500.0, RIG.natural_frequency, 752.0, 1500.0])
    w, w0 = 2 * np.pi * f, RIG.angular_frequency
    root = np.sqrt((w0**2 - w**2) ** 2 + (RIG.damping * w / RIG.mass) ** 2)
    assert RIG.amplitude(f, 3.0) == pytest.approx(RIG.stiffness * 3.0 / root, rel=1e-12)
    assert np.cos(RIG.extension_lag(f)) == pytest.approx((w0**2 - w**2) / root, abs=1e-12)
    assert (RIG.extension_lag(f) > 0).all()
    assert np.abs(RIG.base_response(f)) == pytest.approx(RIG.amplitude(f, 1.0), rel=1e-12)


def test_load_of_a_slow_ground_acceleration_is_minus_mass():
    assert RIG.base_response(0.0) == pytest.approx(-RIG.mass)


def test_delay_turns_the_phase_back():
    late = replace(RIG, delay=1e-4)
    turn = late.base_response(500.0) / RIG.base_response(500.0)
    assert turn == pytest.approx(np.exp(-2j * np.pi * 500 * 1e-4), rel=1e-12)
    assert late.response(500.0) == RIG.response(500.0)


@pytest.mark.parametrize("dynamics", [T128, HEAVY, CRITICAL], ids=["light", "overdamped", "critical"])
def test_balance_load_is_the_integrated_one(dynamics, rng):
    interval = 0.1 / dynamics.natural_frequency
    net = rng.normal(size=40)
    time = np.arange(net.size) * interval
    load, state = [net[0]], (net[0], 0.0)
    w0 = dynamics.angular_frequency
    for k in range(net.size - 1):  # one call an interval: the force has corners at the samples
        solution = solve_ivp(
            lambda t, s, k=k: [
                w0 * s[1],
                w0 * (net[k] + (net[k + 1] - net[k]) * t / interval - s[0]) - dynamics.damping / dynamics.mass * s[1],
            ],
            (0, interval), state, method="DOP853", rtol=1e-11, atol=1e-12,
        )  # fmt: skip
        state = tuple(solution.y[:, -1])
        load.append(state[0])
    # critical damping: poles split by 1e-6 cancel to about eps / 1e-6 times a sum over 40 samples
    assert dynamics.balance_load(net, interval=interval) == pytest.approx(np.array(load), abs=1e-7), time[-1]


def test_balance_load_under_a_ramp_is_the_step_response_over_a_duration():
    interval = 1 / 1600
    net = np.clip(np.arange(400) - 3.0, 0, 10) / 10
    expected = T128.step_response(np.arange(400) * interval - 3 * interval, duration=10 * interval)
    # both exact; rounding of 400 recursions
    assert T128.balance_load(net, interval=interval) == pytest.approx(expected, abs=1e-10)


def test_balance_load_of_a_constant_is_the_constant():
    assert T128.balance_load(np.full(50, 7.5), interval=1e-3) == pytest.approx(np.full(50, 7.5), abs=1e-12)


@pytest.mark.parametrize("quantity", [*PARAMETERS, "natural_frequency", "damping_ratio"])
def test_gradients_are_finite_differences(quantity):
    base = replace(T128, delay=2e-4)
    for place, name in enumerate(PARAMETERS):
        step = 1e-6 * getattr(base, name)
        up, down = (replace(base, **{name: getattr(base, name) + sign * step}) for sign in (1, -1))
        numerical = (getattr(up, quantity) - getattr(down, quantity)) / (2 * step)
        # central difference: relative truncation 1e-12, rounding eps / 1e-6 of the value over the relative slope
        scale = abs(getattr(base, quantity) / getattr(base, name))
        assert base.gradient(quantity)[place] == pytest.approx(numerical, rel=1e-8, abs=1e-8 * scale)


def test_uncertainty_carries_the_covariance():
    covariance = np.diag([0.1, 3e4, 5.0, 0.0]) ** 2
    covariance[0, 1] = covariance[1, 0] = 0.9 * 0.1 * 3e4
    found = replace(T128, covariance=covariance)
    assert found.uncertainty("stiffness") == pytest.approx(3e4)
    assert found.uncertainty("delay") == 0.0
    m, k = 0.1 / T128.mass, 3e4 / T128.stiffness
    relative = np.sqrt(m**2 + k**2 - 2 * 0.9 * m * k) / 2  # f0 = sqrt(k / M) / 2 pi
    assert found.uncertainty("natural_frequency") == pytest.approx(relative * T128.natural_frequency, rel=1e-9)


def test_damping_ratio_and_rates():
    assert T128.damping_ratio == pytest.approx(T128.damping / (2 * np.sqrt(T128.stiffness * T128.mass)))
    power, _ = quad(lambda t: float(T128.free_decay(t)) ** 2, 0, 20 / T128.decay_rate, limit=4000)
    # energy of a light decay: 1 / (4 a), up to the square of the damping ratio and the integration
    assert power == pytest.approx(1 / (4 * T128.decay_rate), rel=1e-3)
    assert T128.natural_frequency == pytest.approx(T128.angular_frequency / (2 * np.pi))


@pytest.mark.parametrize("dynamics", [HEAVY, CRITICAL])
def test_no_free_oscillation_at_or_above_critical(dynamics):
    with pytest.raises(ValueError, match="no free oscillation"):
        _ = dynamics.damped_frequency


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"component": "XX"}, "component must be one of"),
        ({"mass": 0.0}, "mass must be positive"),
        ({"mass": float("nan")}, "mass must be positive"),
        ({"stiffness": -1.0}, "stiffness must be positive"),
        ({"stiffness": float("inf")}, "stiffness must be positive"),
        ({"damping": -1.0}, "damping must be zero or more"),
        ({"delay": float("inf")}, "delay must be finite"),
        ({"covariance": np.zeros((3, 3))}, "shape"),
        ({"covariance": np.diag([-1.0, 0, 0, 0])}, "variances of zero or more"),
        ({"covariance": np.full((4, 4), np.nan)}, "finite"),
    ],
)
def test_unphysical_dynamics_are_refused(changes, words):
    with pytest.raises(ValueError, match=words):
        replace(T128, **changes)


def test_unknown_parameter_is_refused():
    with pytest.raises(ValueError, match="parameter must be one of"):
        T128.gradient("colour")


TWO = T128.with_modes(Mode(165.0, 0.008, -0.05), Mode(310.0, 0.015, 0.03))


def test_shares_of_the_modes_add_to_one():
    assert [mode.share for mode in TWO.modes] == pytest.approx([1.02, -0.05, 0.03], abs=1e-15)
    assert TWO.modes[0].natural_frequency == T128.natural_frequency
    assert complex(TWO.response(0.0)) == pytest.approx(1.0, abs=1e-15)
    assert TWO.step_response(np.array([1e3]))[0] == pytest.approx(1.0, abs=1e-12)


def test_response_of_several_modes_is_that_of_their_masses_and_springs():
    frequency = np.array([0.0, 30.0, 66.4, 165.0, 310.0, 700.0])
    s = 2j * np.pi * frequency
    expected = np.zeros(frequency.size, dtype=complex)
    for mode in TWO.modes:  # METHOD: G(s) = sum of r / (s^2 + 2 zeta w s + w^2), r = share w^2
        w = 2 * np.pi * mode.natural_frequency
        expected += mode.share * w**2 / (s**2 + 2 * mode.damping_ratio * w * s + w**2)
    assert TWO.response(frequency) == pytest.approx(expected, rel=1e-12)


def test_load_of_several_modes_is_the_sum_of_integrated_oscillators():
    time = np.arange(400) / 1600

    def force(t):
        return 50 * np.sin(2 * np.pi * 90 * t)

    expected = sum(
        mode.share
        * integrated(
            Dynamics("AF", 1.0, mode.angular_frequency**2, 2 * mode.damping_ratio * mode.angular_frequency),
            time,
            force,
        )
        for mode in TWO.modes
    )
    fine = np.arange(400 * 16) / 1600 / 16
    found = TWO.balance_load(force(fine), interval=fine[1])[::16]
    # the force is drawn straight between points: an error of (2 pi 90 h)^2 / 12 = 4e-5 of it, times the rise
    assert found == pytest.approx(expected, abs=50 * 4e-5 * 5)
    q, rate = TWO.modes[1].driven(force(fine), interval=fine[1])
    assert np.gradient(q, fine[1])[1:-1] == pytest.approx(rate[1:-1], abs=1e-3 * np.max(np.abs(rate)))


def test_parameters_of_several_modes_have_names_and_slopes():
    assert TWO.parameters[4:] == (
        "natural_frequency_2", "damping_ratio_2", "share_2", "natural_frequency_3", "damping_ratio_3", "share_3",
    )  # fmt: skip
    values = TWO.values
    again = TWO.with_parameters(values)
    assert again.values == pytest.approx(values, rel=0)
    covariance = np.diag(np.linspace(1, 2, values.size) * 1e-4)
    known = replace(TWO, covariance=covariance)
    assert known.uncertainty("share_3") == pytest.approx(np.sqrt(covariance[9, 9]))
    # the first share is 1 less the others
    assert known.uncertainty("share") == pytest.approx(np.sqrt(covariance[6, 6] + covariance[9, 9]))
    with pytest.raises(ValueError, match=r"covariance must have shape \(10, 10\)"):
        replace(TWO, covariance=np.zeros((4, 4)))


@pytest.mark.parametrize(
    ("values", "said"),
    [((0.0, 0.1, 0.1), "natural_frequency"), ((9.0, -0.1, 0.1), "damping_ratio"), ((9.0, 0.1, np.nan), "share")],
)
def test_modes_are_validated(values, said):
    with pytest.raises(ValueError, match=said):
        Mode(*values)


def in_step() -> Dynamics:
    """Two modes whose swings are not in phase."""
    return Dynamics("AF", 20.0, 2e7, 900.0).with_modes(Mode(240.0, 0.02, 0.06, 3e-5))


def test_modes_that_show_their_rate_begin_with_the_load_at_rest():
    balance = in_step()
    first, further = balance.modes
    assert first.share + further.share == pytest.approx(1)
    # what the load is at once after a step, and far above the modes: nothing of first order in time or 1 / s
    assert first.rate_share * first.natural_frequency**2 + further.rate_share * 240.0**2 == pytest.approx(0, abs=1e-12)
    high = np.array([1e5, 2e5])
    assert np.abs(balance.response(high[1:]) / balance.response(high[:1]))[0] == pytest.approx(0.25, rel=1e-3)


def test_modes_that_show_their_rate_agree_in_time_and_frequency():
    balance, interval = in_step(), 1e-5
    time = np.arange(100_000) * interval
    ramp = np.minimum(time / 0.004, 1.0)  # linear between samples, as `balance_load` takes it
    expected = balance.step_response(time, duration=0.004)
    np.testing.assert_allclose(balance.balance_load(ramp, interval=interval), expected, atol=1e-10)
    late = balance.step_response(time - 0.1)
    assert late == pytest.approx(1 - balance.free_decay(time - 0.1), abs=1e-14)
    # the transform of the impulse response, a step's rate, by the trapezoidal rule
    frequency = np.array([30.0, 157.0, 243.0])
    rate = np.gradient(balance.step_response(time), interval)
    turning = np.exp(-2j * np.pi * frequency[:, None] * time)
    found = np.trapezoid(rate * turning, dx=interval, axis=1)
    # (w h)^2 / 6 of the gradient is 4e-5 at 243 Hz; what rings on after 1 s is exp(-22)
    np.testing.assert_allclose(found, balance.response(frequency), rtol=2e-4)


def test_modes_are_printed_with_units_and_uncertainties():
    first = Dynamics("AF", 177.87, 3.093e7, 828.21, covariance=np.diag([0.0, 3.5e3**2, 0.095**2, 0.0]))
    # u(f0) = f0 u(k) / 2 k = 0.0038 Hz; u(zeta) from u(b) / 2 sqrt(k M) = 6.4e-7 and zeta u(k) / 2 k = 3.2e-7
    assert repr(first.modes) == "1 mode\n  66.3680 Hz (u = 0.0038), damping ratio 0.00558302 (u = 7.1e-07)"
    assert repr(first.modes[0]) == "66.368 Hz, damping ratio 0.00558"
    assert repr(first.exact.modes) == "1 mode\n  66.368 Hz, damping ratio 0.00558"
    assert first.modes == tuple(first.modes)
    pair = IndependentDynamics({"AF": first, "NF": replace(first.exact, component="NF")})
    rows = [*repr(first.modes).splitlines()[1:], *repr(first.exact.modes).splitlines()[1:]]
    assert repr(pair.modes).splitlines() == ["2 modes", *rows]
    further = first.with_modes(Mode(150.0, 0.02, 0.1))
    covariance = further.covariance.copy()
    covariance[4, 4], covariance[5, 5] = 0.5**2, 0.001**2
    told = replace(further, covariance=covariance)
    assert repr(told.modes).endswith("\n  150.00 Hz (u = 0.5), damping ratio 0.0200 (u = 0.001), share 0.1")
    assert "further mode 150.00 Hz (u = 0.5), damping ratio 0.0200 (u = 0.001), share 0.1" in repr(told)
    assert repr(pickle.loads(pickle.dumps(told.modes))) == repr(told.modes)


def test_modes_of_coupled_dynamics_are_printed_as_their_covariance_says(rng):
    coupled = coupled_pair()
    # the same by drawing the matrices anew
    values = rng.multivariate_normal(coupled.parameter_values, coupled.total_covariance, size=2000)
    drawn = [[mode.natural_frequency for mode in coupled.with_parameters(one).modes] for one in values]
    np.testing.assert_allclose(coupled.modes.uncertainties[:, 0], np.std(drawn, axis=0), rtol=0.1)  # six of 1.6 %
    first = coupled.modes[0]
    u = coupled.modes.uncertainties[0]
    assert repr(coupled).splitlines()[
        1
    ] == f"  {with_u(first.natural_frequency, u[0], 'Hz')}, damping ratio " + with_u(first.damping_ratio, u[1])
    assert repr(coupled.modes).splitlines()[1:] == repr(coupled).splitlines()[1:]
