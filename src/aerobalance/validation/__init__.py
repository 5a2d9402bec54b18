"""The record against the model, and other methods for comparison."""
