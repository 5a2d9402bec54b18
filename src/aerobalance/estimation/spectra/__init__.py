"""Spectra of the force and of the noise: periodograms, their fit, lines, and noise records."""
