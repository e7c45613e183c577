"""The formula language: syntax, names, types and symbols."""
