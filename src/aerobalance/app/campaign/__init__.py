"""Many runs of a test: what belongs to each, one row a run, on one machine or a cluster, and what they show."""
