"""Annotations of streams (SSL): syntax, checks and storage."""
