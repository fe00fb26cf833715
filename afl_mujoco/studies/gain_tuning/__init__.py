"""Which gains: the paper's genetic search, and what it is asked to minimise."""
