"""Rendering of skylines with OpenGL: the context, the shaders and the rasterizers."""
