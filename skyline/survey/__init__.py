"""Building stores: where places lie, the parts in which they are rendered, and the workers."""
