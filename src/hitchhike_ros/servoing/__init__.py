"""Marker detection and the laws that follow a marker."""
