"""The health of recordings: the timing, stamps and losses of their topics."""
