"""A measured cart-pole: how well the identified model predicts it, and what controllers do."""
