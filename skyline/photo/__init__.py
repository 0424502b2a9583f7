"""From photos, sky masks and traces to skylines in pixels."""
