"""Write the samples of databases; metrosep is not imported.

They were written once by SQLite itself, whose version stands in each file.
Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import base64
import json
import sys
import zlib
from pathlib import Path

X_MM = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]
Z_UM = [1.25, -3.5, None, 7.0, 2.0, -0.5]
ONE = (
    "eNoLDvTJLElVSMsvyk0sUTBmYGJgZGRwUFBgYGBgBmImBgQAsVmQ+IwMhAEzg14yIy9IMeMhBiAaBVQHNoxs4qKi"
    "jLEliUk5qUWlecUgzOQc5OoY4qoQ4ujk46oAElHQqIjPzVUACvvoKFTFl0KYmqC4YWNcz8D4mfEe403G04xHgJxR"
    "MFiBMBszO7sDNBfufwChWVmZGRmZmHhYmNkZ7X9AxNiZmZk5GYSZgMrtocoO8EBobkZmDnb7LxAOAJR6Jtc="
)
TWO = (
    "eNoLDvTJLElVSMsvyk0sUTBmYGJgZGRwUFBgYGBghmIYALFZkPiMDIQBM4NeMiMvkMHE2MDAeAhIjAIU4MDEJi4u"
    "zphYkpiUk5qXn1kMIZidg1wdQ1wVQhydfFwVwEIKGiXxxQpAYR8dhfTEgvi8XDBH04aRTVxUlDEWbEJRaV4xCDOh"
    "6AeJKGhUxOfmQvVXxZdCdYPiho1xPQPjZ8Z7jDcZTzMeAXJGwWAFwmzM7OwO0Fy4/wGEZmVlZmRkYuJhYWZntP8B"
    "EWNnZmbmZBBmAiq3hyo7wAOhuRmZOdjtv0A4oPhnZnzGwPiL8Q2QGgXDErAAEwMjEw8TKIFAU8NPFmAyYGQFADls"
    "QOk="
)


def unpacked(text):
    return zlib.decompress(base64.b64decode(text))


HEIGHTS = [None if z is None else z * 1e-6 for z in Z_UM]
PROFILE = {"kind": "profile", "shape": [6], "x_m": [x * 1e-3 for x in X_MM], "z_m": HEIGHTS}
CASES = {
    "profile.db": (unpacked(ONE), PROFILE),
    "chosen.db": (unpacked(TWO), {**PROFILE, "options": {"sheet": "runs"}}),
    "two-tables.db": (
        unpacked(TWO),
        {"error": "FormatMismatchError", "match": "choose one with sheet='runs'"},
    ),
    "cut-off.db": (unpacked(ONE)[:700], {"error": "CorruptFileError", "match": "is cut off"}),
}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, (data, truth) in CASES.items():
        (folder / "samples" / name).write_bytes(data)
        (folder / "expected" / f"{name}.json").write_text(
            json.dumps(truth, indent=1, sort_keys=True) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
