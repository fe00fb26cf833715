"""Monte Carlo over a laboratory rig: who stays up how often, and the worst that can be found."""
