"""Checks of recordings, one after the other or several at a time."""
