"""The horizon walk as compute shaders (OpenGL 4.3)."""
