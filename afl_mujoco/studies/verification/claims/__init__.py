"""What the paper claims, and what is measured here of each claim."""
