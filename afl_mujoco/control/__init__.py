"""What we command: the paper's law, its gains, and the controllers built from them."""
