"""What was measured: components, channels, clock, sensor correction, resampling, gravity and frames of axes."""
