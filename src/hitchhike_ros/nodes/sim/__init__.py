"""The nodes that stand in for robots, humans and networks, and that watch a run."""
