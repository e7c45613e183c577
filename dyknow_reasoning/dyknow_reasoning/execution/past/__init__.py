"""Operators of the past as registers: their truth at each state is one more field of the state."""
