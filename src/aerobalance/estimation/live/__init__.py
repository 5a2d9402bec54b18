"""The force while the readings come in: fixed-lag smoothing, steps, decoupling and the ground's motion."""
