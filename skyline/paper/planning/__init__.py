"""The paper's planners of renderings: what a view covers (4.2), which to render next (4.3)."""
