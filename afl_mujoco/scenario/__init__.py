"""What is asked: parameters, schedules, disturbances, scenarios. Data only, frozen, in SI units."""
