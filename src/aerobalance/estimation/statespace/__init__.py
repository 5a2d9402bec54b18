"""Linear systems on a clock: shaping filters, Kalman filter and smoother, and their kernels."""
