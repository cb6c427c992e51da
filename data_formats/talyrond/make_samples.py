"""Write the samples of roundness worksheets with zipfile alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import io
import json
import math
import sys
import zipfile
from pathlib import Path

MAIN = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
RELATIONS = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
PACKAGE = "http://schemas.openxmlformats.org/package/2006/relationships"
ANGLES = [0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0]
DEVIATIONS = [20.0, 15.5, -1.25, 0.5, -21.0, -13.0, 2.0, 14.0]
OPTIONS = {"unit": "um", "radius": 0.01}


def rows(angles, deviations):
    """Return angle, r, r cos, r sin of each point; None for an empty cell."""
    turn = math.pi / 180.0
    return [
        (a, None, None, None) if r is None else (a, r, r * math.cos(a * turn), r * math.sin(a * turn))
        for a, r in zip(angles, deviations, strict=True)
    ]  # fmt: skip


def workbook(points):
    """Return a workbook with one worksheet; the last two columns are formulas with their values."""
    lines = []
    for number, point in enumerate(points, start=1):
        cells = [
            f'<c r="{letter}{number}">{f"<f>B{number}</f>" if letter in "CD" else ""}<v>{value!r}</v></c>'
            for letter, value in zip("ABCD", point, strict=True)
            if value is not None
        ]
        lines.append(f'<row r="{number}">{"".join(cells)}</row>')
    members = {
        "[Content_Types].xml": "<Types/>",
        "xl/workbook.xml": f'<workbook {MAIN} xmlns:r="{RELATIONS}"><sheets>'
        '<sheet name="Sheet1" sheetId="1" r:id="rId1"/></sheets></workbook>',
        "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{PACKAGE}"><Relationship Id="rId1" '
        f'Type="{RELATIONS}/worksheet" Target="worksheets/sheet1.xml"/></Relationships>',
        "xl/worksheets/sheet1.xml": f"<worksheet {MAIN}><sheetData>{''.join(lines)}</sheetData></worksheet>",
    }
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, text in members.items():
            info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            info.create_system = 3
            info.compress_type = zipfile.ZIP_STORED  # deflate may differ between versions of zlib
            archive.writestr(info, text.encode())
    return stream.getvalue()


def profile(deviations, **options):
    """Return what a reader must give on a radius of 10 mm."""
    x = [0.01 * a * math.pi / 180.0 for a in ANGLES]
    z = [None if r is None else r * 1e-6 for r in deviations]
    return {"kind": "profile", "shape": [len(x)], "x_m": x, "z_m": z, "options": options}


HOLE = [*DEVIATIONS[:5], None, *DEVIATIONS[6:]]
WHOLE = workbook(rows(ANGLES, DEVIATIONS))
TURNED = [*rows(ANGLES, DEVIATIONS)[:-1], (315.0, 14.0, 14.0, 0.0)]
CASES = {
    "turn.xlsx": (WHOLE, profile(DEVIATIONS, **OPTIONS)),
    "hole.xlsx": (workbook(rows(ANGLES, HOLE)), profile(HOLE, **OPTIONS)),
    "no-unit.xlsx": (
        WHOLE,
        {"error": "UnitError", "match": "declare unit='um' and radius='25 mm'"},
    ),
    "contradiction.xlsx": (
        workbook(TURNED),
        {"error": "FormatMismatchError", "match": "is not a roundness trace"},
    ),
    "cut-off.xlsx": (
        WHOLE[:-40],
        {"error": "CorruptFileError", "match": "is not a whole zip archive"},
    ),
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
