r"""The two balances of the paper and every number it prints about them, each with what its last digit leaves open.

References
----------
.. [Gorbushin2020] A. R. Gorbushin, A. A. Bolshakova, "Unsteady axial force measurement by the strain gauge balance",
   Measurement 152 (2020) 107381. https://doi.org/10.1016/j.measurement.2019.107381
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from aerobalance.dynamics.single import Dynamics


@dataclass(frozen=True, slots=True)
class Printed:
    """A printed number, which stands for every value that rounds to it.

    Attributes
    ----------
    value
        The number as printed.
    half_digit
        Half of its last printed digit.
    unit
        Its unit.
    where
        Section, equation or table of [Gorbushin2020]_ that prints it.
    """

    value: float
    half_digit: float
    unit: str
    where: str

    def __post_init__(self) -> None:
        if not self.half_digit >= 0:
            raise ValueError(f"half_digit must be zero or more, not {self.half_digit}")

    @property
    def low(self) -> float:
        """Least value that rounds to the printed number."""
        return self.value - self.half_digit

    @property
    def high(self) -> float:
        """Largest value that rounds to the printed number."""
        return self.value + self.half_digit

    def overlaps(self, low: float, high: float) -> bool:
        """Whether the range from `low` to `high` meets the range that the printed number stands for."""
        if not low <= high:
            raise ValueError(f"a range must not be reversed: {low} to {high}")
        return self.low <= high and low <= self.high

    def agrees(self, value: float, uncertainty: float = 0.0) -> bool:
        """Whether `value` give or take two standard uncertainties meets the printed range."""
        return self.overlaps(value - 2 * uncertainty, value + 2 * uncertainty)


@dataclass(frozen=True, slots=True)
class PublishedBalance:
    """One balance, the experiment made with it, and what came out, as printed.

    Attributes
    ----------
    name
        Name of the balance.
    half_range
        Half of the axial range; percentages of the paper refer to it [N].
    static_deviation
        Standard deviation of the static calibration [N].
    dynamic_deviation
        Standard uncertainty of the balance readings in the experiment [N].
    live_end_mass, load_mass
        Mass of the live end, and of the load or model on it [kg].
    rate
        Sampling rate [Hz].
    acceleration_deviation
        Standard uncertainty of an accelerometer [m/s^2].
    excitation
        Amplitude of the sine force, or step of the cable force [N].
    frequency
        Natural frequency found: undamped on the vibration rig, damped in the free decay [Hz].
    stiffness, damping
        Stiffness [N/m] and damping [N*s/m] found.
    deviations
        Printed deviations of the verified method, by name.
    """

    name: str
    half_range: Printed
    static_deviation: Printed
    dynamic_deviation: Printed
    live_end_mass: Printed
    load_mass: Printed
    rate: Printed
    acceleration_deviation: Printed
    excitation: Printed
    frequency: Printed
    stiffness: Printed
    damping: Printed
    deviations: dict[str, Printed]

    @property
    def mass(self) -> float:
        """Moving mass M: live end and what is mounted on it [kg]."""
        return self.live_end_mass.value + self.load_mass.value

    @property
    def dynamics(self) -> Dynamics:
        """Axial dynamics with the printed mass, stiffness and damping, taken as exact."""
        return Dynamics(component="AF", mass=self.mass, stiffness=self.stiffness.value, damping=self.damping.value)


VIBRATION_RIG: Final = PublishedBalance(
    name="6F-540",
    half_range=Printed(100.0, 0.0, "N", "section 2.1"),
    static_deviation=Printed(0.32, 0.005, "N", "section 2.1"),
    dynamic_deviation=Printed(0.32, 0.005, "N", "section 2.1"),
    live_end_mass=Printed(0.12, 0.005, "kg", "section 2.2"),
    load_mass=Printed(0.56, 0.005, "kg", "section 2.2"),
    rate=Printed(25e3, 0.0, "Hz", "section 2.1"),
    acceleration_deviation=Printed(5.0, 0.5, "m/s^2", "section 2.1"),
    excitation=Printed(10.0, 0.5, "N", "section 2.1"),
    frequency=Printed(652.5, 0.05, "Hz", "section 4, Eq. (15)"),
    stiffness=Printed(11.43e6, 0.005e6, "N/m", "section 4"),
    damping=Printed(371.98, 0.005, "N*s/m", "section 4, Eq. (16)"),
    deviations={
        "harmonic": Printed(0.3, 0.05, "N", "section 4"),
        "harmonic at the natural frequencies": Printed(3.5, 0.05, "N", "section 4"),
    },
)
"""Balance 6F-540 on the vibration rig (ground vibration testing), sections 2.1 and 4 of [Gorbushin2020]_."""

SECOND_FREQUENCY: Final = Printed(752.0, 0.5, "Hz", "sections 2.1 and 4")
"""Natural frequency of the whole vibration rig."""

TOTAL_MASS: Final = Printed(1.48, 0.005, "kg", "section 2.1")
"""Load, balance and balance adapter on the vibration rig together."""

CABLE_CUT: Final = PublishedBalance(
    name="6-EB-128-1",
    half_range=Printed(2000.0, 0.0, "N", "section 2.3"),
    static_deviation=Printed(2.0, 0.5, "N", "section 2.3"),
    dynamic_deviation=Printed(10.0, 0.5, "N", "section 2.3"),
    live_end_mass=Printed(8.33, 0.005, "kg", "section 2.3"),
    load_mass=Printed(169.54, 0.005, "kg", "section 2.3"),
    rate=Printed(1600.0, 0.0, "Hz", "section 2.3"),
    acceleration_deviation=Printed(5.0, 0.5, "m/s^2", "section 2.3"),
    excitation=Printed(1020.0, 5.0, "N", "section 5"),
    frequency=Printed(66.4, 0.05, "Hz", "section 5"),
    stiffness=Printed(3.093e7, 0.0005e7, "N/m", "section 5, Eq. (20)"),
    damping=Printed(828.21, 0.005, "N*s/m", "section 5, Eq. (7)"),
    deviations={
        "mean": Printed(2.0, 0.5, "N", "section 5"),
        "momentary, of half range": Printed(3.0, 0.5, "%", "section 5"),
    },
)
"""Balance 6-EB-128-1 with a model in the T-128 tunnel, released by burning a cable, sections 2.3 and 5."""


@dataclass(frozen=True, slots=True)
class TableRow:
    """One line of the paper's comparison tables.

    Attributes
    ----------
    source
        Reference of the paper, or ``"paper"`` for the paper's own.
    method
        How the deviation was found.
    deviation
        Relative deviation, give or take [%].
    """

    source: str
    method: str
    deviation: Printed


def _row(source: str, method: str, percent: float, half_digit: float, table: str) -> TableRow:
    return TableRow(source, method, Printed(percent, half_digit, "%", table))


TABLE_1: Final = (
    _row("[8]", "shock tunnel against short-duration tunnel", 4.57, 0.005, "Table 1"),
    _row("[12]", "step force", 3.0, 0.5, "Table 1"),
    _row("[14]", "shock tunnel against short-duration tunnel", 4.69, 0.005, "Table 1"),
    _row("[15]", "shock tunnel against short-duration tunnel", 3.5, 0.05, "Table 1"),
    _row("[17]", "impulse force", 0.53, 0.005, "Table 1"),
    _row("paper", "step force", 0.2, 0.05, "Table 1"),
)
"""Relative deviation of the mean axial force; the paper's own is 2 N of the 1.02 kN step."""

TABLE_2: Final = (
    _row("[7]", "harmonic force, two balances compared (correction factor)", 10.3, 0.05, "Table 2"),
    _row("[12]", "step force", 9.8, 0.05, "Table 2"),
    _row("[12]", "impulse force", 11.0, 0.5, "Table 2"),
    _row("paper", "harmonic force, of half range", 0.3, 0.05, "Table 2"),
    _row("paper", "step force, of half range", 3.0, 0.5, "Table 2"),
)
"""Relative deviation of the momentary axial force."""
