"""Progression as look-ups: the timed automaton of a formula, its configurations, its instances."""
