"""Identification from a table of AF/F."""

import warnings

import numpy as np
import pytest
from scipy.stats import chi2

from aerobalance.dynamics.single import Dynamics
from aerobalance.identification.base_excitation.frf_table import ResponseTable, identify_frf
from aerobalance.recording.errors import DataQualityWarning, FitError

TRUE = Dynamics("AF", mass=2.0, stiffness=2.0 * (2 * np.pi * 900.0) ** 2, damping=2 * 0.02 * 2.0 * 2 * np.pi * 900.0)
FREQUENCIES = np.array([20.0, 50, 100, 200, 300, 400, 500, 600, 700, 800, 850, 880, 900, 920, 950, 1000, 1200])


def table(frequency, generator=None, *, delay=0.0, u=(0.005, 0.01), scatter=1.0, true=TRUE) -> ResponseTable:
    """A table with relative uncertainty of the amplitude and uncertainty of the phase [rad], scattered accordingly."""
    frequency = np.asarray(frequency, dtype=float)
    response = true.response(frequency) * np.exp(-2j * np.pi * frequency * delay)
    amplitude, phase = np.abs(response), np.angle(response)
    u_amplitude, u_phase = u[0] * amplitude, np.full(frequency.size, u[1])
    if generator is not None:
        amplitude = amplitude + scatter * u_amplitude * generator.standard_normal(frequency.size)
        phase = phase + scatter * u_phase * generator.standard_normal(frequency.size)
    return ResponseTable(frequency, amplitude, u_amplitude, phase, u_phase)


def test_exact_table_gives_exact_dynamics():
    fit = identify_frf(table(FREQUENCIES), mass=2.0)
    assert fit.dynamics.stiffness == pytest.approx(TRUE.stiffness, rel=1e-9)
    assert fit.dynamics.damping == pytest.approx(TRUE.damping, rel=1e-7)
    assert not fit.delay_found
    assert fit.degrees_of_freedom == 2 * FREQUENCIES.size - 2


@pytest.mark.soak(first=0)
@pytest.mark.filterwarnings("ignore::aerobalance.recording.errors.DataQualityWarning")
def test_scores_of_many_tables(rng):
    draws, scores, sums = 200, [], []
    for _ in range(draws):
        fit = identify_frf(table(FREQUENCIES, rng), mass=2.0)
        d = fit.dynamics
        scores.append([(getattr(d, n) - getattr(TRUE, n)) / d.uncertainty(n) for n in ("stiffness", "damping")])
        sums.append(fit.chi2 / fit.degrees_of_freedom)
    low, high = np.sqrt(chi2.ppf([1e-5, 1 - 1e-5], draws) / draws)
    # By chance a delay is taken up in 6 % of the tables (BIC of 34 numbers), which widens the scatter a little.
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    assert np.all((rms > 0.95 * low) & (rms < 1.1 * high)), rms
    assert np.mean(sums) == pytest.approx(1.0, abs=5 * np.sqrt(2 / 31 / draws) + 0.05)


# The scatter of one table in a hundred is doubted by chance; the delay is found all the same.
@pytest.mark.filterwarnings("ignore:.*scatter more than their:aerobalance.recording.errors.DataQualityWarning")
def test_delay_is_found_where_there_is_one(rng):
    fit = identify_frf(table(FREQUENCIES, rng, delay=-4e-5, u=(0.002, 0.003)), mass=2.0)
    assert fit.delay_found
    assert abs(fit.dynamics.delay + 4e-5) < 5 * fit.dynamics.uncertainty("delay")
    assert abs(fit.dynamics.damping - TRUE.damping) < 5 * fit.dynamics.uncertainty("damping")


def test_uncertain_mass_scales_stiffness_and_damping():
    fit = identify_frf(table(FREQUENCIES, u=(1e-5, 1e-5)), mass=(2.0, 0.02)).dynamics
    # k = M w0^2 and b = M w0 (b w0 / k): the response fixes the other factors.
    assert fit.uncertainty("stiffness") == pytest.approx(0.01 * fit.stiffness, rel=1e-3)
    assert fit.uncertainty("damping") == pytest.approx(0.01 * fit.damping, rel=1e-2)


def test_too_much_scatter_enlarges_the_covariance_and_warns(rng):
    noisy = table(FREQUENCIES, rng, scatter=3.0)
    with pytest.warns(DataQualityWarning, match="scatter more than their uncertainties"):
        fit = identify_frf(noisy, mass=2.0)
    assert fit.probability < 0.01
    assert fit.scale == pytest.approx(fit.chi2 / fit.degrees_of_freedom)
    # 31 or 32 degrees of freedom, nine times the variance: 3.3 to 19 at one in 1e5.
    assert 3.3 < fit.scale < 20


def test_points_short_of_resonance_are_called_extrapolation():
    with pytest.warns(DataQualityWarning, match="no point reaches the natural frequency"):
        fit = identify_frf(table(np.arange(100.0, 801.0, 50.0), u=(1e-3, 1e-4)), mass=2.0)
    assert fit.dynamics.natural_frequency == pytest.approx(900.0, rel=1e-6)


def test_damping_that_the_table_does_not_carry_is_called_so():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        fit = identify_frf(table(np.arange(50.0, 500.0, 50.0), u=(1e-3, 0.05)), mass=2.0)
    assert any("damping is hardly identifiable" in str(warning.message) for warning in caught)
    assert any("damping is hardly identifiable" in note for note in fit.notes)
    assert all(issubclass(warning.category, DataQualityWarning) for warning in caught)


def test_tables_that_cannot_carry_a_result(rng):
    with pytest.raises(FitError, match="do not carry the stiffness"):
        identify_frf(table(np.arange(1.0, 10.0), rng), mass=2.0)
    with pytest.raises(FitError, match="too few"):
        identify_frf(table([900.0]), mass=2.0)
    with pytest.raises(FitError, match=r"5 point\(s\) at 1 frequency are too few .* three different frequencies"):
        identify_frf(table([900.0] * 5), mass=2.0)


def test_wrong_tables_are_named():
    good = table(FREQUENCIES)
    with pytest.raises(ValueError, match="u_amplitude of point 1 must be positive"):
        ResponseTable(good.frequency, good.amplitude, np.zeros(17), good.phase, good.u_phase)
    with pytest.raises(ValueError, match="phase must have shape"):
        ResponseTable(good.frequency, good.amplitude, good.u_amplitude, good.phase[:3], good.u_phase)
    with pytest.raises(ValueError, match="phase of point 2 is not"):
        phase = good.phase.copy()
        phase[1] = np.nan
        ResponseTable(good.frequency, good.amplitude, good.u_amplitude, phase, good.u_phase)
    with pytest.raises(ValueError, match="mass must be positive"):
        identify_frf(good, mass=0.0)
