"""One module a node, for robots and for simulations."""
