"""The nodes of semantic grounding."""
