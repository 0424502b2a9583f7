"""Matching: from a query's skyline to a ranked list of places and poses."""
