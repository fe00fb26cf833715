"""The loop with the force held, in MuJoCo: hardware, steps, whole runs and batches of them."""
