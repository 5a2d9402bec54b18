"""The balance of the published cable cut."""

from aerobalance.dynamics.single import Dynamics

T128 = Dynamics("AF", 177.87, 3.093e7, 828.21)
"""Axial force [kg, N/m, kg/s]; rings at 66.37 Hz."""
