"""Dynamics from a shaken ground end: stepped sine, sweep or random, one component or several."""
