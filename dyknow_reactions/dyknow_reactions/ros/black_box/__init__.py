"""The node that records black boxes."""
