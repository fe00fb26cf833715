"""From where does the loop settle? Maps of thousands of rollouts, by equations and in MuJoCo."""
