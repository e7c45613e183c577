"""Semantic matching of concepts with annotated streams."""
