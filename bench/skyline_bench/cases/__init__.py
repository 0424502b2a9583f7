"""Hard cases: scenes that a renderer could break on, each with its truth and its bound."""
