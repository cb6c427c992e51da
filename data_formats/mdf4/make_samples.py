"""Write the samples of MDF files with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
import zlib
from pathlib import Path


class File:
    """Blocks in order; links are offsets of blocks that were added before."""

    def __init__(self, version="4.10"):
        self.data = bytearray(
            f"MDF     {version}    metrosep".encode().ljust(28, b"\0") + struct.pack("<H", 410)
        )
        self.data += bytes(64 - len(self.data)) + bytes(24 + 48 + 32)  # place of HD

    def add(self, name, links=(), body=b"", at=None):
        """Return the offset of a new block."""
        body += bytes(-len(body) % 8)
        length = 24 + 8 * len(links) + len(body)
        block = (
            b"##"
            + name.encode()
            + bytes(4)
            + struct.pack(f"<QQ{len(links)}Q", length, len(links), *links)
            + body
        )
        at = at or len(self.data)
        self.data[at : at + length] = block
        return at

    def text(self, text, name="TX"):
        """Return the offset of a text."""
        return self.add(name, (), text.encode() + b"\0")

    def finish(self, first):
        """Return the file, whose header leads to its first data group."""
        self.add(
            "HD",
            (first, 0, 0, 0, 0, 0),
            struct.pack("<QhhBBBx16x", 1_700_000_000_000_000_000, 60, 0, 0, 0, 0),
            64,
        )
        return bytes(self.data)


def conversion(file, kind, *values, unit=""):
    unit = file.text(f"<CNunit><TX>{unit}</TX></CNunit>", "MD") if unit else 0
    return file.add(
        "CC",
        (0, unit, 0, 0),
        struct.pack(f"<BBHHH2d{len(values)}d", kind, 0, 0, 0, len(values), 0, 0, *values),
    )


def channel(
    file,
    after,
    name,
    kind,
    byte,
    bits,
    *,
    type_=0,
    sync=0,
    bit=0,
    cc=0,
    unit="",
    flags=0,
    invalid=0,
):
    """Return a channel that leads to the one after it."""
    name, unit = file.text(name), file.text(unit) if unit else 0
    body = (
        struct.pack("<4B4I", type_, sync, kind, bit, byte, bits, flags, invalid)
        + bytes(4)
        + bytes(48)
    )
    return file.add("CN", (after, 0, name, 0, cc, 0, unit, 0), body)


def group(file, records, width, first, *, data=None, invalid=0, count=None, after=0):
    data = file.add("DT", (), b"".join(records)) if data is None else data
    cycles = len(records) if count is None else count
    cg = file.add(
        "CG", (0, first, 0, 0, 0, 0), struct.pack("<QQHHIII", 0, cycles, 0, 0, 0, width, invalid)
    )
    return file.add("DG", (after, cg, data, 0), bytes(8))


TIMES, GAP, TEMP = [0.5, 0.75, 2.0], [-100, 7, 32000], [1.5, -2.25, 40.0]


def usual(*, layout="plain", data=None, count=None, kind=1, sync=1):
    """Return times, a scaled 16-bit gap with an invalid sample, 12 bits at bit 2, a big-endian float."""
    file = File()
    flags = (0, 1, 0)
    records = [
        struct.pack("<dhH", t, g, (k + 5) << 2) + struct.pack(">f", v) + bytes([flag])
        for k, (t, g, v, flag) in enumerate(zip(TIMES, GAP, TEMP, flags, strict=True))
    ]  # fmt: skip
    last = channel(file, 0, "temperature", 5, 12, 32, unit="°C")
    last = channel(file, last, "bits", 0, 10, 12, bit=2)
    last = channel(
        file, last, "gap", 2, 8, 16, cc=conversion(file, kind, 10.0, 0.5, unit="nm"), flags=2
    )
    first = channel(file, last, "time", 4, 0, 64, type_=2, sync=sync, unit="s")
    if layout == "list":
        whole = b"".join(records)
        turned = b"".join(bytes(r[k] for r in records[:2]) for k in range(17))
        packed = zlib.compress(turned)
        dz = file.add(
            "DZ", (), struct.pack("<2sBxIQQ", b"DT", 1, 17, len(turned), len(packed)) + packed
        )
        data = file.add(
            "DL", (0, dz, file.add("DT", (), whole[34:])), struct.pack("<B3xI2Q", 0, 2, 0, 34)
        )
    return file.finish(group(file, records, 16, first, data=data, invalid=1, count=count))


TRUTH = {"kind": "recording", "t_s": TIMES, "channels": {
    "gap": [-40e-9, None, 16010e-9], "bits": [5.0, 6.0, 7.0], "temperature": TEMP}}  # fmt: skip
RAW = {**TRUTH, "channels": {**TRUTH["channels"], "gap": [-100.0, None, 32000.0]},
       "warnings_match": "conversion 3"}  # fmt: skip
LOOP = File()
LOOP.add("DG", (len(LOOP.data), 0, 0, 0), bytes(8))
CASES = {
    "plain.mf4": (usual(), TRUTH),
    "list-deflated.mf4": (usual(layout="list"), TRUTH),
    "formula.mf4": (usual(kind=3), RAW),
    "over-angle.mf4": (usual(sync=2), {"error": "UnsupportedFeatureError", "match": "not over time"}),
    "claims-more.mf4": (usual(count=4), {"error": "CorruptFileError", "match": "samples end early"}),
    "claims-absurd.mf4": (usual(count=2**40), {"error": "CorruptFileError", "match": "cycles"}),
    "loop.mf4": (LOOP.finish(168), {"error": "CorruptFileError", "match": "without end"}),
    "cut-off.mf4": (usual()[:-30], {"error": "CorruptFileError", "match": "does not fit"}),
}  # fmt: skip


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
