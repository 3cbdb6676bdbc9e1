"""Random fleets on bad networks, and the rules that they must never break."""
