"""Evaluation of formulas by calls to the other nodes."""
