"""Write a corpus of bad files: every sample damaged in the usual ways, and hostile ones.

Run ``python tools/make_bad_files.py FOLDER``. The files are made from ``data_formats/*/samples``
without metrosep, so that other readers can be tried on them too; the tests read all of them.
"""

import io
import os
import pickle
import struct
import sys
import zipfile
import zlib
from pathlib import Path

SAMPLES = Path(__file__).resolve().parents[1] / "data_formats"

XML = """<?xml version="1.0" encoding="UTF-8"?>{doctype}
<p:ISO5436_2 xmlns:p="http://www.opengps.eu/2008/ISO5436_2"><Record1><Revision>ISO5436 - 2000</Revision>
<FeatureType>SUR</FeatureType><Axes>
<CX><AxisType>I</AxisType><DataType>D</DataType><Increment>{step}</Increment><Offset>0</Offset></CX>
<CY><AxisType>I</AxisType><DataType>D</DataType><Increment>1e-6</Increment><Offset>0</Offset></CY>
<CZ><AxisType>A</AxisType><DataType>D</DataType><Increment>1</Increment><Offset>0</Offset></CZ>
</Axes></Record1><Record2><Date>{date}</Date></Record2>
<Record3><MatrixDimension><SizeX>{n}</SizeX><SizeY>{n}</SizeY><SizeZ>1</SizeZ></MatrixDimension>
<DataLink><PointDataLink>{link}</PointDataLink></DataLink></Record3></p:ISO5436_2>
"""
LAUGHS = (
    '<!DOCTYPE x [<!ENTITY a "ha">'
    + "".join(f'<!ENTITY {chr(98 + i)} "{f"&{chr(97 + i)};" * 10}">' for i in range(12))
    + "]>"
)
OUTSIDE = '<!DOCTYPE x [<!ENTITY m SYSTEM "file:///etc/hostname">]>'


def x3p(*, n=2, link="bindata/data.bin", data=b"\0" * 32, step="1e-6", doctype="", date="2026"):
    """Return an X3P archive."""
    text = XML.format(n=n, link=link, step=step, doctype=doctype, date=date)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("main.xml", text)
        archive.writestr("bindata/data.bin", data)
    return stream.getvalue()


class Runs:
    """What a pickle would run; it must never be loaded."""

    def __reduce__(self):
        return (os.system, ("echo a pickle was run > PICKLE_WAS_RUN",))


def npy(payload, descr, shape):
    """Return a ``.npy`` file."""
    text = repr({"descr": descr, "fortran_order": False, "shape": shape}).ljust(117) + "\n"
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(text)) + text.encode() + payload


def hostile():
    """Return file names and contents that attack a reader on purpose."""
    return {
        "bomb.x3p": x3p(n=2, data=b"\0" * 2**26),
        "zeros.x3p": x3p(n=2000, data=b"\0" * (8 * 2000**2)),
        "claims-40000000000-points.x3p": x3p(n=200000),
        "billion-laughs.x3p": x3p(doctype=LAUGHS, date="&m;"),
        "entity-outside.x3p": x3p(doctype=OUTSIDE, date="&m;"),
        "path-traversal.x3p": x3p(link="../../../../etc/hostname"),
        "step-nan.x3p": x3p(step="NaN"),
        "step-zero.x3p": x3p(step="0"),
        "pickle.npy": npy(pickle.dumps(Runs()), "|O", (1,)),
        "pickle.bin": pickle.dumps(Runs()),
        "claims-8-TB.npy": npy(b"\0" * 64, "<f8", (1000000, 1000000)),
        "zlib-bomb.sur": b"DSCOMPRESSED" + b"\0" * 500 + zlib.compress(b"\0" * 2**24),
        "quotes.csv": b'x_mm,z_um\n"1,2\n' + b"3,4\n" * 1000,
        "one-long-line.csv": b"1," * 200_000,
        "nul.csv": b"x_mm,z_um\n1,2\n\0\0\0\n",
        "huge-number.csv": b"x_mm,z_um\n0,1e999\n1,2\n2,3\n",
        "deep.gwy": b"GWYPGwyContainer\0" + struct.pack("<I", 2**31) + b"/0/data\0o" * 500,
        "zeros.dat": b"\0" * 4096,
        "ones.dat": b"\xff" * 4096,
        "one-byte.dat": b"\x88",
    }


def damaged(data):
    """Return the usual accidents of one file."""
    head = min(len(data), 64)
    return {
        "half": data[: len(data) // 2],
        "64-bytes": data[:head],
        "no-head": b"\0" * head + data[head:],
        "head-of-ones": b"\xff" * head + data[head:],
        "turned-round": data[::-1],
        "twice": data + data,
        "text-mode": data.replace(b"\n", b"\r\n"),
        "tail-of-zeros": data[: len(data) // 2] + b"\0" * (len(data) - len(data) // 2),
    }


def main(folder):
    """Write the corpus into a folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in hostile().items():
        (folder / name).write_bytes(content)
    for sample in sorted(SAMPLES.glob("*/samples/*")):
        own = sample.parents[1].name
        for kind, content in damaged(sample.read_bytes()).items():
            name = f"{own}--{sample.stem}--{kind}{sample.suffix}"
            (folder / name).write_bytes(content)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
