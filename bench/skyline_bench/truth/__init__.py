"""What is right: the oracle and the simulation, and how far others are from them."""
