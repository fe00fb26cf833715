"""The checks: of the equations, of the closed loop, of the references, and what explains them."""
