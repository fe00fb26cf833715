"""M and l estimated online, from encoders and the force."""
