"""Simulation: (scenario, controller, settings) -> Trajectory, analytically and in MuJoCo."""
