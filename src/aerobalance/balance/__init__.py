"""The static side: matrix, calibration, weighing, zeros, and from gauge outputs to the loads that are felt."""
