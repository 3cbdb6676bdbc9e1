"""Conversions between ROS messages and datatypes, and parameters."""
