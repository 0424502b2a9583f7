"""The figures of README and docs/: tables and sentences that are written from the records."""
