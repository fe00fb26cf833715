"""What the paper's law is measured against: LQR, pole placement, partial linearisation."""
