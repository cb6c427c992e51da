"""Write the samples of ISO 5436-2 profiles with plain text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

HEIGHTS = [-0.296539, -0.270753, 0.5, -0.219181, -0.180502]  # in um, no symmetry
CX = "CX\0 I\0 5 mm\0 1.0e0 D\0 2.5e-4"
CZ = "CZ\0 A\0 5 um\0 1.0e0 D\0"


def smd(heights, *, cx=CX, cz=CZ, feature="PRF", zero="\0", modulus=65536, wrong=0, end="\r\n"):
    etx = "\x03" + end
    text = end.join(["ISO 5436 - 2000\0bump\0", f"{feature}\0 1 ISO5436\0", cx, cz, etx])
    text += end.join(["DATE 03-Jan-2026\0", "TIME 12:00\0", "COMMENT /* planted bump */\0", etx])
    text += end.join([*map(str, heights), etx])
    body = text.replace("\0", zero).encode("latin-1")
    total = (sum(body) + wrong) % modulus
    return body + f"{total}{end}{etx}".encode("latin-1") + b"\x1a"


def truth(heights, *, step=2.5e-7, scale=1e-6, **more):
    x = [step * i for i in range(len(heights))]
    z = [v * scale for v in heights]
    return {"kind": "profile", "shape": [len(x)], "x_m": x, "z_m": z, **more}


def samples():
    """Yield name, bytes and expectation."""
    yield "profile.smd", smd(HEIGHTS), truth(HEIGHTS)
    yield "no-zero-bytes.smd", smd(HEIGHTS, zero=" ", modulus=65535, end="\n"), truth(HEIGHTS)
    counts = [int(v * 1e4) for v in HEIGHTS]
    scaled = smd(counts, cz="CZ\0 A\0 5 nm\0 1.0e-1 L\0")
    yield "integers.smd", scaled, truth(counts, scale=1e-10)
    wrong = truth(HEIGHTS, warnings_match="checksum")
    yield "wrong-checksum.smd", smd(HEIGHTS, wrong=1), wrong
    corrupt, unsupported = {"error": "CorruptFileError"}, {"error": "UnsupportedFeatureError"}
    yield "too-few.smd", smd(HEIGHTS[:-1]), {**corrupt, "match": "do not fill the profile"}
    yield "cut-off.smd", smd(HEIGHTS)[:180], {**corrupt, "match": "a record is not closed"}
    yield "surface.smd", smd(HEIGHTS, feature="SUR"), {**unsupported, "match": "holds a surface"}
    own = smd(HEIGHTS, cx="CX\0 A\0 5 mm\0 1.0e0 D\0")
    yield "own-positions.smd", own, {**unsupported, "match": "positions of its own"}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, data, expected in samples():
        (folder / "samples" / name).write_bytes(data)
        text = json.dumps(expected, indent=1, sort_keys=True, allow_nan=False) + "\n"
        (folder / "expected" / f"{name}.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
