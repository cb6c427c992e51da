"""Write the samples of halsampler text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

ROWS = [(1.5, -0.25, 1), (2.5, 0.75, 0), (4.0, -1.75, 1), (8.5, 3.25, 0)]
NUMBERS = [7, 8, 12, 13]  # three samples are lost
NAMES = ["x-pos", "probe", "touch"]


def text(*, numbered):
    """Return the text: floats with six decimals, bits as 0 and 1, a blank after each number."""
    lines = []
    for k, (x, probe, touch) in enumerate(ROWS):
        if k == 2:
            lines.append("overrun")
        tag = f"{NUMBERS[k]} " if numbered else ""
        lines.append(f"{tag}{x:f} {probe:f} {touch} ")
    return "\n".join(lines) + "\n"


def truth(rows, t, factor, options):
    columns = zip(*rows, strict=True)
    values = {n: [v * factor for v in c] for n, c in zip(NAMES, columns, strict=True)}
    options = {"format": "halsampler", "sampling_rate": 1000.0, "names": NAMES, **options}
    return {"kind": "recording", "t_s": t, "channels": values, "options": options}


CASES = {
    "numbered.txt": (
        text(numbered=True),
        truth(ROWS, [0.0, 1e-3, 5e-3, 6e-3], 1e-3, {"numbered": True, "unit": "mm"}),
    ),
    "second-part.txt": (text(numbered=False), truth(ROWS[2:], [0.0, 1e-3], 1.0, {"segment": 1})),
}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, (content, expected) in CASES.items():
        (folder / "samples" / name).write_bytes(content.encode())
        record = json.dumps(expected, indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(record, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
