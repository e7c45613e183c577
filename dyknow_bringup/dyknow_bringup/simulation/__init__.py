"""Simulation of a fleet of UAVs, and of links that fail."""
