"""Films of runs: MuJoCo's cart-pole, mutated as it runs, with the ideal ODE as a ghost."""
