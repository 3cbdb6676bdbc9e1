"""Path search on grids and the overlap of paths."""
