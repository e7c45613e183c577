"""Regions, their relations, and who can reach whom."""
