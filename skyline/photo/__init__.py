"""Photos, sky masks and traces to query skylines."""
