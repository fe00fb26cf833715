"""The verification of MuJoCo against the equations: criteria, checks, claims, the campaign."""
