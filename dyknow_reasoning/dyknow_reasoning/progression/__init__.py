"""Progression of formulas, state by state."""
