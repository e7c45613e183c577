"""Recordings on disk: their topics, and the fields of their messages as columns."""
