"""Calibration: a load schedule becomes a balance matrix, with the statistics to trust it by.

`fit` makes the matrix: from the `normalised_points`, with their tares, by the `regression` of every component on the
terms of the `selection`, with `shrinkage` of their coefficients. `checks` refuses schedules with faults, `quality`
gives the statistics, `fit_warnings` warns of weaknesses that residuals do not show, and `comparison` compares two
calibrations.
"""
