"""A measured cart-pole: logs, what identifies it from them, and what it predicts."""
