"""Measurements: what each command measures, row by row."""
