"""How the sky model that Skyline ships is made: drawn photographs, a network, its training."""
