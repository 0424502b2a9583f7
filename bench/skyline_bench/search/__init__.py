"""Comparisons of stores and queries: stores, trials and summaries."""
