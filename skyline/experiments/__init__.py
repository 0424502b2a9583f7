"""Experiments: made-up queries with known answers, and what is measured with them."""
