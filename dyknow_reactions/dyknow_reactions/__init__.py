"""Reactions to verdicts: black boxes, triggers and guards."""
