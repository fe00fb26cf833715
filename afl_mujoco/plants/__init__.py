"""Plants: an MJCF, its names and parameters, and the equations that it should obey."""
