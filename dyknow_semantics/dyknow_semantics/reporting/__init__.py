"""Ontologies and matches, as shown to people and programs."""
