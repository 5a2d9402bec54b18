"""Dynamics of one component from a free decay of its load."""
