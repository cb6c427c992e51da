"""Write the samples of Mitutoyo workbooks with zipfile alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import io
import json
import sys
import zipfile
from pathlib import Path

MAIN = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
RELATIONS = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
PACKAGE = "http://schemas.openxmlformats.org/package/2006/relationships"
POINTS = [(0.0015, 5.5), (0.003, -1.25), (0.0045, 20.0), (0.006, -3.0)]
RESULTS = ["Ra     7.437  µm      ", "Rsk    -0.144         ", "RSm    419.9  µm      "]
SETTINGS = ["CUT 2.5mm", "CUV R"]


def sheet(rows):
    """Return a worksheet; text as (index,) of the shared texts, None for an empty cell."""
    lines = []
    for number, row in enumerate(rows, start=1):
        cells = [
            f'<c r="{letter}{number}"' + (
                f' t="s"><v>{value[0]}</v></c>' if isinstance(value, tuple) else f"><v>{value}</v></c>"
            )
            for letter, value in zip("ABCDEF", row, strict=False)
            if value is not None
        ]  # fmt: skip
        lines.append(f'<row r="{number}">{"".join(cells)}</row>')
    return f"<worksheet {MAIN}><sheetData>{''.join(lines)}</sheetData></worksheet>"


def workbook(points, *, results=RESULTS, names=("Certificate", "DATA"), head=""):
    """Return a workbook with the given points."""
    texts = [*results, *SETTINGS, "20- Jun -2023"]
    rows = []
    for i, (x, z) in enumerate([*points, (None, None)]):
        a = (i,) if i < len(results) else None
        b = (len(results) + i,) if i < len(SETTINGS) else None
        rows.append((a, b, 0.25 * i, 99 - i, x, z))
    sheets = "".join(
        f'<sheet name="{n}" sheetId="{i}" r:id="rId{i}"/>' for i, n in enumerate(names, 1)
    )
    targets = "".join(
        f'<Relationship Id="rId{i}" Type="{RELATIONS}/worksheet" Target="worksheets/sheet{i}.xml"/>'
        for i in (1, 2)
    )
    members = {
        "[Content_Types].xml": "<Types/>",
        "xl/workbook.xml": f'<workbook {MAIN} xmlns:r="{RELATIONS}"><sheets>{sheets}</sheets></workbook>',
        "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{PACKAGE}">{targets}</Relationships>',
        "xl/worksheets/sheet1.xml": sheet([(None,) * 4 + ((len(texts) - 1,),)]),
        "xl/worksheets/sheet2.xml": head + sheet(rows),
        "xl/sharedStrings.xml": f"<sst {MAIN}>{''.join(f'<si><t>{t}</t></si>' for t in texts)}</sst>",
    }
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, text in members.items():
            info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            info.create_system = 3
            info.compress_type = zipfile.ZIP_STORED  # deflate may differ between versions of zlib
            archive.writestr(info, text.encode())
    return stream.getvalue()


def profile(points=POINTS, **more):
    """Return what a reader must give."""
    x = [p[0] * 1e-3 for p in points]
    z = [None if p[1] is None else p[1] * 1e-6 for p in points]
    return {"kind": "profile", "shape": [len(x)], "x_m": x, "z_m": z, **more}


HOLE = [*POINTS[:1], (0.003, None), *POINTS[2:]]
BOMB = '<!DOCTYPE a [<!ENTITY b "bbbbbbbb"><!ENTITY c "&b;&b;&b;">]>'
MICROINCH = [r.replace("µm", "µin") for r in RESULTS]
CASES = {
    "plain.xlsx": (workbook(POINTS), profile()),
    "hole.xlsx": (workbook(HOLE), profile(HOLE)),
    "no-results.xlsx": (workbook(POINTS, results=[]), profile(options={"unit": ["mm", "um"]})),
    "microinch.xlsx": (
        workbook(POINTS, results=MICROINCH),
        {"error": "UnitError", "match": "show no unit of the heights (µin)"},
    ),
    "no-position.xlsx": (
        workbook([POINTS[0], (None, 1.0), POINTS[2]]),
        {"error": "CorruptFileError", "match": "field E2, expected a number"},
    ),
    "entities.xlsx": (
        workbook(POINTS, head=BOMB),
        {"error": "CorruptFileError", "match": "declares a document type or entities"},
    ),
    "cut-off.xlsx": (
        workbook(POINTS)[:-40],
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
