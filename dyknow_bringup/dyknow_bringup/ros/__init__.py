"""Executables: the demonstration, its simulation, replay, and the dyknow command."""
