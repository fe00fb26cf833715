"""Imperfection thresholds: how much delay, noise, friction and so on each controller survives."""
