"""Binary maps of heights: a reader for each format, behind the declared header of that format."""
