"""The workbench: what a page shows of a measurement, and the words it speaks with its server.

The drawing modules (`pyramid`, `map_views`, `section_views`, `profile_views`, `spectrum_views`,
`wire`) know no server and no browser: numbers go in, arrays for the screen come out. No number
that decides anything is taken from them; verdicts come from the full data.
"""
