"""One pure core for each node of P17 Fig. 8, and the robot that they make together, wired once."""
