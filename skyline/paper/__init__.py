"""The paper's own methods: its matcher (section 3), reprojection error (4.2), strategies (4.3)."""
