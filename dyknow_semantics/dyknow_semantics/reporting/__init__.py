"""Presentation of ontologies and matches on a terminal and as JSON."""
