"""Films of runs: a plant in MuJoCo, mutated as it runs, with the ideal ODE as a ghost."""
