"""Verdicts as a recording: messages at their times."""
