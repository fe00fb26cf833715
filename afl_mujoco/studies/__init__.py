"""The studies, one folder each, found by `registry`; shared code is beside the folders."""
