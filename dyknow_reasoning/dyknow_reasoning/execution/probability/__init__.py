"""Probabilities of formulas over uncertain numbers: bounds, exact, or simulated."""
