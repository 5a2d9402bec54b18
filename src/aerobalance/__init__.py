"""The force that was really applied, from the readings of a wind-tunnel strain-gauge balance."""

__version__ = "0.1.0"
