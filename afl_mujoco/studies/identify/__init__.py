"""What is identified of a cart-pole from its logs."""
