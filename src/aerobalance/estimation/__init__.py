"""From loads to the force: spectra, state space, steps, the smoother of a whole record and the live one."""
