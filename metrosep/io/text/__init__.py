"""Text: how a table of numbers is written and read, and the formats of text that have a reader."""
