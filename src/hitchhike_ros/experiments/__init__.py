"""Scenarios, their figures and reports."""
