"""Builders of the abstract syntax that several languages have."""
