"""Matching: from a photo's skyline to a ranked list of poses."""
