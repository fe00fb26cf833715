"""The realism ladder: what of the paper's ideal loop a controller can do without, and how much."""
