"""Positions on an axis: ISO 230-2, repeatability, errors that repeat with a period."""
