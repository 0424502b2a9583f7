"""Trials: matchers run on synthetic queries, and how wrong their answers are."""
