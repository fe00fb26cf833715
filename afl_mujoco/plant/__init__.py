"""What nature does: the analytic equations of motion of the paper."""
