"""Printed numbers of the vibration rig (sections 2.1, 2.2 and 4), by overlapping ranges."""

import itertools

import numpy as np
import pytest

from aerobalance.dynamics.single import stiffness_from_damped_frequency
from aerobalance.identification.base_excitation.paper_procedure import reference_fit
from aerobalance.identification.base_excitation.rig import identify_rig
from aerobalance.identification.base_excitation.sine_dwell import find_dwells, harmonic_check
from aerobalance.simulation import ARMATURE_MASS, Sensor, Simulation, SteppedSine, VibrationRig
from aerobalance.simulation.published import (
    CABLE_CUT,
    SECOND_FREQUENCY,
    TABLE_1,
    TABLE_2,
    TOTAL_MASS,
    VIBRATION_RIG,
    Printed,
)
from seeds import new_seed

FREQUENCIES = (*np.arange(300.0, 600.0, 50.0), *np.arange(600.0, 650.0, 10.0), 652.5, *np.arange(660.0, 750.0, 10.0),
               752.0, *np.arange(760.0, 1000.0, 30.0))  # fmt: skip


def corners(*numbers: Printed):
    """Every combination of the ends of the ranges that printed numbers stand for."""
    return itertools.product(*((number.low, number.high) for number in numbers))


@pytest.fixture(scope="module")
def experiment() -> Simulation:
    """The rig with the printed dynamics, 0.05 N and 0.05 m/s^2 noise, steady dwells."""
    sensors = {name: Sensor(noise=0.05) for name in ("AF", "ground_acceleration", "live_acceleration")}
    drive = SteppedSine(FREQUENCIES, settle=0.05, hold=0.15)
    return VibrationRig(sensors=sensors).run(drive, np.random.default_rng(new_seed()))


def test_stiffness_mass_and_frequency_agree():
    # k = M (2 pi f0)^2 with M = 0.12 + 0.56.
    rig = VIBRATION_RIG
    values = [(a + b) * (2 * np.pi * f) ** 2 for a, b, f in corners(rig.live_end_mass, rig.load_mass, rig.frequency)]
    assert rig.stiffness.overlaps(min(values), max(values))
    assert rig.mass == pytest.approx(0.68)
    # With the mass itself taken as exact the two still agree.
    exact = [rig.mass * (2 * np.pi * f) ** 2 for f in (rig.frequency.low, rig.frequency.high)]
    assert rig.stiffness.overlaps(min(exact), max(exact))


def test_damping_ratio_of_the_rig():
    rig = VIBRATION_RIG
    values = [
        b / (2 * np.sqrt(k * (m1 + m2)))
        for b, k, m1, m2 in corners(rig.damping, rig.stiffness, rig.live_end_mass, rig.load_mass)
    ]
    assert Printed(0.0667, 0.00005, "1", "METHOD").overlaps(min(values), max(values))


def test_total_mass_exceeds_the_moving_mass():
    assert VIBRATION_RIG.live_end_mass.high + VIBRATION_RIG.load_mass.high < TOTAL_MASS.low


def test_free_free_pole_is_the_second_frequency():
    rig = VIBRATION_RIG
    values = [
        f * np.sqrt(1 + (m1 + m2) / ARMATURE_MASS)
        for f, m1, m2 in corners(rig.frequency, rig.live_end_mass, rig.load_mass)
    ]
    assert SECOND_FREQUENCY.overlaps(min(values), max(values))
    assert SECOND_FREQUENCY.agrees(rig.frequency.value * np.sqrt(1 + rig.mass / ARMATURE_MASS))


def test_natural_frequency_stiffness_and_damping_are_found_again(experiment):
    simulation = experiment
    fit = identify_rig(simulation.recording, mass=VIBRATION_RIG.mass)
    found = fit.dynamics
    assert VIBRATION_RIG.frequency.agrees(found.natural_frequency, found.uncertainty("natural_frequency"))
    assert VIBRATION_RIG.stiffness.agrees(found.stiffness, found.uncertainty("stiffness"))
    # The damping is printed to 1e-5: what is found has to meet it within 4 of its own standard uncertainties.
    u = found.uncertainty("damping")
    assert VIBRATION_RIG.damping.overlaps(found.damping - 4 * u, found.damping + 4 * u)
    assert u < 5e-3 * found.damping


def test_the_papers_own_procedure_finds_them_too(experiment):
    simulation = experiment
    fit = reference_fit(find_dwells(simulation.recording), mass=VIBRATION_RIG.mass)
    # Lines through the origin carry the noise of the accelerometer into their abscissa: 0.05 Hz and 0.1 % are seen.
    assert VIBRATION_RIG.frequency.overlaps(fit.natural_frequency - 0.2, fit.natural_frequency + 0.2)
    assert VIBRATION_RIG.damping.overlaps(fit.damping * 0.995, fit.damping * 1.005)


def test_harmonic_deviation_is_below_the_printed_one(experiment):
    simulation = experiment
    dwells = find_dwells(simulation.recording)
    checks = harmonic_check(simulation.recording, dwells, dynamics=VIBRATION_RIG.dynamics)
    worst = max(abs(check.deviation) for check in checks)
    assert len(dwells) == len(FREQUENCIES)
    assert worst <= 0.1 <= VIBRATION_RIG.deviations["harmonic"].low
    assert worst < VIBRATION_RIG.deviations["harmonic at the natural frequencies"].low


def test_harmonic_deviation_in_percent_of_half_range():
    newtons = VIBRATION_RIG.deviations["harmonic"]
    half_range = VIBRATION_RIG.half_range.value
    paper = next(row for row in TABLE_2 if row.source == "paper" and "harmonic" in row.method)
    assert paper.deviation.overlaps(100 * newtons.low / half_range, 100 * newtons.high / half_range)


def test_cable_cut_numbers_agree_with_each_other():
    cut = CABLE_CUT
    values = [
        stiffness_from_damped_frequency(f, m1 + m2, b)
        for f, m1, m2, b in corners(cut.frequency, cut.live_end_mass, cut.load_mass, cut.damping)
    ]
    assert cut.stiffness.overlaps(min(values), max(values))
    assert cut.mass == pytest.approx(177.87)
    assert Printed(0.0056, 0.00005, "1", "METHOD").agrees(cut.dynamics.damping_ratio)
    assert cut.frequency.agrees(cut.dynamics.damped_frequency)


def test_mean_deviation_of_table_1_is_two_newtons_of_the_step():
    paper = next(row for row in TABLE_1 if row.source == "paper")
    mean, step = CABLE_CUT.deviations["mean"], CABLE_CUT.excitation
    assert paper.deviation.overlaps(100 * mean.low / step.high, 100 * mean.high / step.low)


def test_momentary_deviation_of_table_2_is_sixty_newtons():
    paper = next(row for row in TABLE_2 if row.source == "paper" and "step" in row.method)
    assert paper.deviation.value / 100 * CABLE_CUT.half_range.value == 60.0


def test_every_baseline_method_of_the_tables_is_worse_than_the_paper():
    for table in (TABLE_1, TABLE_2):
        paper = max(row.deviation.high for row in table if row.source == "paper")
        assert all(row.deviation.low > paper for row in table if row.source != "paper")


def test_a_printed_number_stands_for_a_range():
    number = Printed(66.4, 0.05, "Hz", "section 5")
    assert number.overlaps(66.2, 66.36)
    assert not number.overlaps(66.46, 67.0)
    assert number.agrees(66.5, 0.03)
    with pytest.raises(ValueError, match="reversed"):
        number.overlaps(2.0, 1.0)
    with pytest.raises(ValueError, match="half_digit"):
        Printed(1.0, -0.1, "N", "nowhere")
