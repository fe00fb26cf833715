"""Baselines for the paper's controller: LQR, pole placement, partial linearisation."""
