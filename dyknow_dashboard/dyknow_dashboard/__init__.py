"""A live page of formulas, streams and nodes."""
