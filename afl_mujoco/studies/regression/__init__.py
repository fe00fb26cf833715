"""Regression: every run of the paper's scenarios against its baseline."""
