"""The nodes of a robot."""
