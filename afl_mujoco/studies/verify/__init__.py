"""What `validate` judges and shows: criteria, checks, explanations, claims, curves, figures."""
