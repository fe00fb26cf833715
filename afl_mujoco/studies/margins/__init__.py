"""Stability margins of the linearised loop over the plants, and the delay measured in MuJoCo."""
