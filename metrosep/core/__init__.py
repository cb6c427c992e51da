"""Objects, units, provenance and errors; numpy only."""
