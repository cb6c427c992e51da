"""Straightness of lines: two and three points, probes in a row, slopes, reversal, ISO 230-1."""
