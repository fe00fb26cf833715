"""Readings of what the paper leaves open: under which of them its numbers hold."""
