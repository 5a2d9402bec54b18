"""Dynamics of coupled components from loads that are let go."""
