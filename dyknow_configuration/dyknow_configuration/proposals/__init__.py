"""Proposals for a robot.yaml, from what topics were observed to publish."""
