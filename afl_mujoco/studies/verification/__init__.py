"""Is it true: metrics, criteria, checks, and the campaign that runs them."""
