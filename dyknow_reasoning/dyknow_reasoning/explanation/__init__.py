"""Texts for people: why a formula is decided, and what remains of an undecided one."""
