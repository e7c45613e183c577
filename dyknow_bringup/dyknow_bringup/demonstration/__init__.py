"""Formulas, expected verdicts and tables of the demonstration."""
