"""Progression of many instances at once, as numpy vectors."""
