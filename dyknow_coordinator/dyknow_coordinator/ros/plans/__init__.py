"""Monitoring of plans: the action, the service and their messages."""
