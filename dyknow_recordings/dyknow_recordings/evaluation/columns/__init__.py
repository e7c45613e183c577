"""Streams as columns: the samples of many messages at once, by numpy."""
