"""Metric temporal logic over streams, evaluated by progression."""
