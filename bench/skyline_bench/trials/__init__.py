"""Trials: matchers run on made queries, and how wrong their answers are."""
