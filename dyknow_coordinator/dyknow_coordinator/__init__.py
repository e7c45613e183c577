"""Grounding formulas, running their evaluations and answering."""
