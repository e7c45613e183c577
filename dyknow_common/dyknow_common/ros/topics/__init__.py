"""The topics that a node subscribes to: their names, their publishers, and unusable messages."""
