"""Checks of files: what is wrong in them, and what means nothing."""
