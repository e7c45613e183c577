"""The plan monitoring interfaces of the coordinator."""
