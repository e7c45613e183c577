"""Ontologies: storage, names, hierarchy and reasoners."""
