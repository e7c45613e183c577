"""Topics as sources of streams."""
