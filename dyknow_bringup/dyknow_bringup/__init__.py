"""Everything to start DyKnow: a UAV fleet simulation, configuration and the demonstration."""
