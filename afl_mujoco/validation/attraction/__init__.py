"""From where each law settles: where the ideal equations and MuJoCo disagree."""
