"""Reports about streams, for people and programs."""
