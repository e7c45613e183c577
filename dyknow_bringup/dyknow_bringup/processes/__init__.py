"""The processes of a running DyKnow."""
