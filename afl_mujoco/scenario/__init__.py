"""Parameters, schedules, disturbances, scenarios. Data only, frozen, in SI units."""
