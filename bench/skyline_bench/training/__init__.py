"""How the sky model that Skyline ships is made: drawn photographs, and a network trained on them."""
