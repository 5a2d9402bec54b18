"""Calibration: a load schedule becomes a balance matrix, with the statistics to trust it by.

`fit` makes the matrix: from the `scaled` points, with their tares, by the `regression` of every component on the terms
of the `selection`. `faults` refuses what no matrix should come of, `quality` says how good it is, `doubts` warns of
what makes it worse than it looks, and `drift` compares two calibrations.
"""
