"""Occupancy grids, map files and new obstacles."""
