"""Reports on evaluations, for operators."""
