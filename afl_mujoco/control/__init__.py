"""What we command: the paper's controller, its gains, and the controllers built from them."""
