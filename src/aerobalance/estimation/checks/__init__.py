"""What a record says against what its force is worked out with."""
