"""The simulated world, its robots and their sensors."""
