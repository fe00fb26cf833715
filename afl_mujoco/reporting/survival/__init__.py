"""What the survival studies found, as tables and figures."""
