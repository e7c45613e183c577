"""Evaluations, as operators see them."""
