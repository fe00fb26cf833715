"""Monte Carlo over laboratory hardware: survival rates, and the worst case found by a search."""
