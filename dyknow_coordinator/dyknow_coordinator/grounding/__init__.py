"""Grounding: from the symbols of a formula to a state stream."""
