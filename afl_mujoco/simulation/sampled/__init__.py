"""The sampled loop in MuJoCo: hardware, steps, whole runs and batches of runs."""
