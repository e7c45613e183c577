"""Margins of formulas: how far a formula is from the change of its verdict (its robustness)."""
