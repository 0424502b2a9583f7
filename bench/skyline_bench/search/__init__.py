"""Comparisons of stores x queries: stores to build, trials, and summaries of the answers."""
