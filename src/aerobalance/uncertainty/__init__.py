"""What is not known: budget, Monte Carlo, planning, and what the calibration leaves."""
