"""The controllers: the paper's control law, its gains, and what is built from them."""
