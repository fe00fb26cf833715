"""Figures of a run, and the gallery of a campaign's report."""
