"""Identification of a cart-pole from its logs."""
