"""Planes of two axes: grids that calibrate themselves, squareness and diagonals, ISO 230-6."""
