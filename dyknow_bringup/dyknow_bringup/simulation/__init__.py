"""Simulation of a fleet of UAVs."""
