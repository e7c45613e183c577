"""The node of a guard."""
