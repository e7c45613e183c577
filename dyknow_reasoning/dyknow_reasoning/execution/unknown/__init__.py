"""Progression over states with unknown values: over all that these values may be."""
