"""The stream language: syntax, names and types."""
