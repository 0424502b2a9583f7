"""From photos, sky masks and traces to query skylines, with the camera that a file notes."""
