"""Calibration: a load schedule becomes a balance matrix, with the statistics to trust it by.

`fit` makes the matrix and finds the tares, by the `regression` of every component on the terms that `terms` chooses;
`faults` refuses what no matrix should come of; `quality` says how good it is; `drift` compares two calibrations.
"""
