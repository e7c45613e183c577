"""Explanations of verdicts and texts of residual formulas."""
