"""A measured cart-pole: how far the identified model predicts it, and what it would survive."""
