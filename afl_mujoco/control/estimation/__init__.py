"""What the law believes when nobody tells it: M and l estimated from encoders and the force."""
