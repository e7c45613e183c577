"""Formulas that are asked at every state: the undecided start states, and the verdicts on them."""
