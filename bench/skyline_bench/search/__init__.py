"""Stores x queries: what is built, what is looked for, and how what is found is counted."""
