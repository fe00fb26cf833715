"""Regions of attraction: from which starts each controller settles, by equations and in MuJoCo."""
