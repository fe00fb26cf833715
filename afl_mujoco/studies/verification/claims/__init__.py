"""The claims of the paper, and what is measured here for each."""
