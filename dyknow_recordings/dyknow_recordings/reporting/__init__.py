"""Results as tables, files for machines, and pages for people."""
