"""Planning: which viewpoints are worth a rendering."""
