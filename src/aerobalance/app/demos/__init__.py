"""Demonstrations on simulated experiments, from end to end."""
