"""Drift in time: A-B-B-A, a drift beside an error, ISO 230-3, dependence on speed and temperature."""
