"""Regions of attraction: from where each controller settles, by the equations and in MuJoCo."""
