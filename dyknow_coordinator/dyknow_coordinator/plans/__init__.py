"""Monitoring of the execution of plans."""
