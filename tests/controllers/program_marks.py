"""The comment by which a corrected program is known, taken off to compare what it says otherwise."""

import re

MARK = re.compile(
    r"(\(METROSEP CORRECTED Z( X)? [0-9a-f]{12}\)|;METROSEP CORRECTED Z( X)? [0-9a-f]{12})(\r\n|\n|\r)"
)


def unmarked(text: str) -> str:
    """The text without its one mark, or as it is where nothing was corrected."""
    assert len(MARK.findall(text)) == text.count("METROSEP") <= 1
    return MARK.sub("", text)
