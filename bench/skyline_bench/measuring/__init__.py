"""Measuring: the machine, times, memory, processes and records."""
