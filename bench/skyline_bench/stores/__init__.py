"""Stores to measure with, and what they must withstand."""
