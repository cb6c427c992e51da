"""The separation layer."""
