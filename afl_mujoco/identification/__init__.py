"""A measured cart-pole: its logs, its identification from them, and predictions of them."""
