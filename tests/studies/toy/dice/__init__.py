"""A toy study: throw dice. Everything that it needs is in this folder."""
