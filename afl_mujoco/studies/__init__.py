"""The studies, one file each; what they share is in `shared`, what validates in `verify`."""
