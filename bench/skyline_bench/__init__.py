"""Benchmarks of Skyline, which itself imports none of them.

``commands/`` has a file for each subject: its commands and how they measure. ``search/`` is stores
x queries. The other folders hold what several commands use: ``queries/``, ``truth/`` (the oracle,
the hard cases, the paper's simulation), ``peers/`` and ``measuring/`` (clocks, records, workers).
"""
