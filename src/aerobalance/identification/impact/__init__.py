"""Identification from taps with an instrumented hammer: a measured force at known points and directions."""
