"""Methods of the upper layers that have a name: machines, processes, quality, plans."""
