"""Grounding: the streams for the symbols of a formula, joined in a state stream (section V)."""
