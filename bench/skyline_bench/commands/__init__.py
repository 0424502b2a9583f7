"""Commands of ``skyline-bench``: options, tables and records."""
