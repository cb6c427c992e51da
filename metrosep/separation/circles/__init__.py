"""Roundness, spindles and angles: reversals, probes round a circle, steps, closure, ISO 230-7."""
