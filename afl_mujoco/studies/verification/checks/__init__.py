"""The checks of the equations, of the closed loop and of the references, and explanations."""
