"""Fast progression of the instances of many formulas."""
