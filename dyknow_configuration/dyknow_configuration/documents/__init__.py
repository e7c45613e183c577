"""YAML documents, with the positions of their parts."""
