"""Write the samples of X3P files with zipfile and struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import hashlib
import io
import json
import math
import struct
import sys
import zipfile
from pathlib import Path

CODES = {"I": "h", "L": "i", "F": "f", "D": "d"}
NAN = math.nan


def md5(data):
    return hashlib.md5(data, usedforsecurity=False).hexdigest()


def axis(name, kind, code, increment, offset):
    step = "" if increment is None else f"<Increment>{increment!r}</Increment>"
    return (
        f"<{name}><AxisType>{kind}</AxisType><DataType>{code}</DataType>{step}"
        f"<Offset>{offset!r}</Offset></{name}>"
    )


def document(feature, axes, size, link, *, root="p:ISO5436_2"):
    space = 'xmlns:p="http://www.opengps.eu/2008/ISO5436_2"'
    if len(size) == 1:
        dimension = f"<ListDimension>{size[0]}</ListDimension>"
    else:
        sizes = "".join(f"<Size{k}>{n}</Size{k}>" for k, n in zip("XYZ", (*size, 1), strict=True))
        dimension = f"<MatrixDimension>{sizes}</MatrixDimension>"
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<{root} {space}><Record1><Revision>ISO5436 - 2000'
        f"</Revision><FeatureType>{feature}</FeatureType><Axes>{''.join(axes)}</Axes></Record1>"
        "<Record2><Date>2026-01-03T00:00:00</Date><Instrument><Manufacturer>none</Manufacturer>"
        "<Model>made by hand</Model><Serial>0</Serial><Version>1</Version></Instrument>"
        "<CalibrationDate>2026-01-03T00:00:00</CalibrationDate><ProbingSystem><Type>Software</Type>"
        "<Identification>none</Identification></ProbingSystem></Record2>"
        f"<Record3>{dimension}{link}</Record3>"
        f"<Record4><ChecksumFile>md5checksum.hex</ChecksumFile></Record4></{root}>\n"
    ).encode()


def archive(main, members, *, main_md5=None, folder=""):
    stream = io.BytesIO()
    everything = {
        "main.xml": main,
        **members,
        "md5checksum.hex": f"{main_md5 or md5(main)} *main.xml\n".encode(),
    }
    with zipfile.ZipFile(stream, "w") as target:
        for name, data in everything.items():
            info = zipfile.ZipInfo(folder + name, date_time=(1980, 1, 1, 0, 0, 0))
            info.create_system = 3
            info.external_attr = 0o644 << 16
            target.writestr(info, data, compress_type=zipfile.ZIP_STORED)
    return stream.getvalue()


def link(data, mask=None):
    text = (
        "<DataLink><PointDataLink>bindata/data.bin</PointDataLink>"
        f"<MD5ChecksumPointData>{md5(data)}</MD5ChecksumPointData>"
    )
    if mask is not None:
        text += (
            "<ValidPointsLink>bindata/valid.bin</ValidPointsLink>"
            f"<MD5ChecksumValidPoints>{md5(mask)}</MD5ChecksumValidPoints>"
        )
    return text + "</DataLink>"


def pack(code, values):
    return b"".join(struct.pack("<" + CODES[code], v) for v in values)


def bits(valid):
    data = bytearray((len(valid) + 7) // 8)
    for j, good in enumerate(valid):
        data[j // 8] |= good << (j % 8)
    return bytes(data)


def grid(code, scale, offset):
    return [
        axis("CX", "I", "D", 1.5e-6, 1e-3),
        axis("CY", "I", "D", 2.5e-6, 2e-3),
        axis("CZ", "A", code, scale, offset),
    ]


# first row = smallest y; the bump is in its last column, the hole in the last row
HEIGHTS = [[0.0, 1.0, 90.0], [2.0, 3.0, 4.0], [NAN, 5.0, -6.0], [7.0, 8.0, 9.0]]
FLAT = [v for row in HEIGHTS for v in row]
SIZE = (3, 4)


def single(value):
    return struct.unpack("<f", struct.pack("<f", value))[0]


def surface(scale=1.0, offset=0.0):
    z = [[None if math.isnan(v) else v * scale + offset for v in row] for row in HEIGHTS]
    steps = {"dx_m": 1.5e-6, "dy_m": 2.5e-6, "origin_m": [1e-3, 2e-3]}
    return {"kind": "surface", "shape": [4, 3], "z_m": z, **steps}


def samples():
    """Yield name, bytes and expectation."""
    metres = [v * 1e-9 for v in FLAT]
    data = pack("D", metres)
    main = document("SUR", grid("D", None, 0.0), SIZE, link(data))
    bindata = {"bindata/data.bin": data}
    yield "double.x3p", archive(main, bindata), surface(1e-9)
    wrong = {"warnings_match": "MD5 of main.xml is wrong"}
    yield "wrong-md5.x3p", archive(main, bindata, main_md5="0" * 32), {**surface(1e-9), **wrong}
    inside = {"warnings_match": "lies in the folder"}
    yield "in-a-folder.x3p", archive(main, bindata, folder="part7/"), {**surface(1e-9), **inside}
    data = pack("F", FLAT)
    main = document("SUR", grid("F", 1e-9, 0.0), SIZE, link(data))
    yield "float.x3p", archive(main, {"bindata/data.bin": data}), surface(1e-9)
    mask = bits([not math.isnan(v) for v in FLAT])
    for code in "IL":
        data = pack(code, [0 if math.isnan(v) else int(v) for v in FLAT])
        main = document("SUR", grid(code, 2e-9, 1e-6), SIZE, link(data, mask))
        members = {"bindata/data.bin": data, "bindata/valid.bin": mask}
        yield f"integer-{code}-mask.x3p", archive(main, members), surface(2e-9, 1e-6)
    datums = "".join("<Datum/>" if math.isnan(v) else f"<Datum>{v!r}</Datum>" for v in metres)
    main = document("SUR", grid("D", 1.0, 0.5), SIZE, f"<DataList>{datums}</DataList>")
    yield "ascii-offset.x3p", archive(main, {}), surface(1e-9, 0.5)
    yield from profiles()
    yield from clouds()
    yield from hostile()


def profiles():
    x, z = [0.0, 1e-6, 3e-6, 4e-6], [1e-9, 2e-9, NAN, -4e-9]
    heights = [None if math.isnan(v) else v for v in z]
    axes = [
        axis("CX", "I", "D", 1e-6, 5e-6),
        axis("CY", "I", "D", 1.0, 0.0),
        axis("CZ", "A", "D", None, 0.0),
    ]
    data = pack("D", z)
    truth = {"kind": "profile", "shape": [4], "x_m": [5e-6 + 1e-6 * i for i in range(4)]}
    main = document("PRF", axes, (4, 1), link(data))
    yield "profile.x3p", archive(main, {"bindata/data.bin": data}), {**truth, "z_m": heights}
    axes[0] = axis("CX", "A", "D", None, 0.0)
    z[2] = 3e-9
    data = b"".join(pack("D", pair) for pair in zip(x, z, strict=True))
    truth = {"kind": "profile", "shape": [4], "x_m": x, "z_m": z}
    main = document("PRF", axes, (4, 1), link(data))
    yield "profile-positions.x3p", archive(main, {"bindata/data.bin": data}), truth


def clouds():
    """Yield lists of points and a surface whose points carry their positions."""
    axes = [axis(n, "A", "D", None, 0.0) for n in ("CX", "CY", "CZ")]
    points = [
        (1e-3 + 1.5e-6 * c, 2e-3 + 2.5e-6 * r, HEIGHTS[r][c] * 1e-9)
        for r in range(4)
        for c in range(3)
        if not math.isnan(HEIGHTS[r][c])
    ]
    mixed = [points[(5 * i + 3) % 11] for i in range(11)]
    data = b"".join(pack("D", p) for p in mixed)
    main = document("PCL", axes, (11,), link(data))
    yield "points.x3p", archive(main, {"bindata/data.bin": data}), surface(1e-9)
    datums = "".join(f"<Datum>{';'.join(map(repr, p))}</Datum>" for p in mixed)
    main = document("PCL", axes, (11,), f"<DataList>{datums}</DataList>")
    yield "points-ascii.x3p", archive(main, {}), surface(1e-9)
    whole = [(1.5e-6 * c, HEIGHTS[r][c] * 1e-9) for r in range(4) for c in range(3)]
    data = b"".join(pack("D", p) for p in whole)
    axes[1] = axis("CY", "I", "D", 2.5e-6, 2e-3)
    main = document("SUR", axes, SIZE, link(data))
    yield (
        "surface-positions.x3p",
        archive(main, {"bindata/data.bin": data}),
        {
            **surface(1e-9),
            "origin_m": [0.0, 2e-3],
        },
    )
    axes[1] = axis("CY", "A", "D", None, 0.0)
    loose = [(x + 3.7e-7 * i * i, y, z) for i, (x, y, z) in enumerate(points)]
    data = b"".join(pack("D", p) for p in loose)
    main = document("PCL", axes, (11,), link(data))
    scattered = {"error": "UnsupportedFeatureError", "match": "are scattered"}
    yield "points-scattered.x3p", archive(main, {"bindata/data.bin": data}), scattered


def hostile():
    data = pack("D", [1e-9] * 12)
    bindata = {"bindata/data.bin": data}
    corrupt = {"error": "CorruptFileError"}
    main = document(
        "SUR", grid("D", None, 0.0), SIZE, link(data).replace("bindata/", "../../etc/")
    )
    yield "link-outside.x3p", archive(main, bindata), {**corrupt, "match": "outside of itself"}
    main = document("SUR", grid("D", None, 0.0), (4000, 4000), link(data))
    yield (
        "too-little-data.x3p",
        archive(main, bindata),
        {**corrupt, "match": "do not fill the map"},
    )
    main = document("SUR", grid("D", None, 0.0), (200000, 200000), link(data))
    claim = {"error": "UnsupportedFeatureError", "match": "200000 x 200000"}
    yield "absurd-size.x3p", archive(main, bindata), claim
    axes = grid("D", None, 0.0)
    axes[0] = axis("CX", "I", "D", NAN, 0.0)
    main = document("SUR", axes, SIZE, link(data))
    yield "nan-step.x3p", archive(main, bindata), {**corrupt, "match": "CX/Increment"}
    entity = b'<!DOCTYPE a [<!ENTITY b "c"><!ENTITY d "&b;&b;&b;&b;&b;&b;&b;&b;">]><ISO5436_2>&d;</ISO5436_2>'
    yield (
        "entities.x3p",
        archive(entity, bindata),
        {**corrupt, "match": "document type or entities"},
    )


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, data, truth in samples():
        (folder / "samples" / name).write_bytes(data)
        text = json.dumps(truth, indent=1, sort_keys=True, allow_nan=False) + "\n"
        (folder / "expected" / f"{name}.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
