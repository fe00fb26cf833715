"""Tuning of the gains: the paper's genetic search, and the cost that it minimises."""
