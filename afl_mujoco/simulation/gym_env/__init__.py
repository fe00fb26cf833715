"""The scenarios as Gymnasium environments; Gymnasium is an optional package."""
