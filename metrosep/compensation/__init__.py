"""The compensation layer."""
