"""Controllers side by side, as deployed in MuJoCo, and whether they meet the requirements."""
