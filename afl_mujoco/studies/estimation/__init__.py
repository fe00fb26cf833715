"""How well M and l are estimated online, and what this costs the closed loop."""
