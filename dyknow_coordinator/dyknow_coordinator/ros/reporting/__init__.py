"""Status topics and diagnostics of evaluations."""
