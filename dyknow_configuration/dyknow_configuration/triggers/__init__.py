"""Triggers of a robot.yaml: what is done when the verdict on a formula changes."""
