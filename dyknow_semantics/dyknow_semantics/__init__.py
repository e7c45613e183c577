"""Semantic grounding: ontologies, annotations of streams (SSL) and matching."""
