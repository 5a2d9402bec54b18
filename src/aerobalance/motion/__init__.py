"""Motion of the ground (non-metric) end: from its sensors to six accelerations and rates."""
