"""Where the loop settles from: maps of thousands of rollouts, by equations and in MuJoCo."""
