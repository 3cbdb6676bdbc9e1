"""Figures of what was driven, each with its bound."""
