"""State streams of a group of formulas."""
