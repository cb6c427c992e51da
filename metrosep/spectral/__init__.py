"""The spectral layer."""
