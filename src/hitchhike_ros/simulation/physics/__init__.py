"""The pybullet world: bodies, wheels, lasers and cameras."""
