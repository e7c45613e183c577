"""Formulas as markers in a three-dimensional view."""
