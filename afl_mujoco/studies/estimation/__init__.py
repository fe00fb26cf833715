"""How well M and l are estimated online, and what that costs the closed loop."""
