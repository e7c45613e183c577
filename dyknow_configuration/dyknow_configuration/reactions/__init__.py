"""Reactions to verdicts in a robot.yaml."""
