"""How a camera was held: by its skyline at a known place, or by control points."""
