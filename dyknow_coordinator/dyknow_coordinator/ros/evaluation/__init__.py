"""Evaluation of formulas over state streams."""
