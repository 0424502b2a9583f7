"""Machine, clocks, memory, processes and records: how anything is measured."""
