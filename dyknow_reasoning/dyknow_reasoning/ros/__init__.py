"""The node that evaluates formulas."""
