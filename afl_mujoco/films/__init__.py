"""Films of runs: MuJoCo's cart-pole, mutated as it runs, beside the ideal ODE's ghost."""
