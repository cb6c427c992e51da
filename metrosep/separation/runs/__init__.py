"""Repeated runs of one axis: what belongs to the axis, and what to vibration, lag and noise."""
