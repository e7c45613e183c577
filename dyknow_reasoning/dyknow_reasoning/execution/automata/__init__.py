"""Timed automata that cache the steps of progression."""
