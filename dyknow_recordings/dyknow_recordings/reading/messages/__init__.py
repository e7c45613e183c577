"""Serialised messages: their types, and their fields as columns."""
