"""Regions: what they are, and the documents that describe them."""
