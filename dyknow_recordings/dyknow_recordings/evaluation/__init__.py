"""Formulas over recordings, with the verdicts of the running system."""
