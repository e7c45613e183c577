"""Worker processes: work that cannot be interrupted, which is killed at its limits."""
