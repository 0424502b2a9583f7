"""The tables and sentences of README and docs/, written from records."""
