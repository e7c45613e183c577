"""All nodes of DyKnow in one process."""
