"""Everything to start DyKnow: a UAV fleet simulation, configuration and the demonstration."""
# It imports nothing: a node that starts needs few of the modules.
