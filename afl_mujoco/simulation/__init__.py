"""What happens: (scenario, controller, settings) -> Trajectory, analytically and in MuJoCo."""
