"""The plant: the analytic equations of motion of the paper."""
