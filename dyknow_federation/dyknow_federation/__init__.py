"""Several hosts: their clocks, links, and what they share."""
