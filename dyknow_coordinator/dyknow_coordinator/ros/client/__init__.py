"""Clients of the coordinator, for any node."""
