"""A law in Python in the loops of fixed steps, which run every other law compiled."""
