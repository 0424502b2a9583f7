"""The truth: the oracle, hard cases with bounds, and the paper's simulation."""
