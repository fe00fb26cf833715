"""The report as one HTML file, from the files of a validation."""
