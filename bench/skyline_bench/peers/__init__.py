"""Other programs that Skyline is compared with."""
