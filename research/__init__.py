"""The paper's searches, and what its numbers rest on: outside the package, run by make targets."""
