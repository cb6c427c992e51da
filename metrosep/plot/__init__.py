"""The plot layer."""
