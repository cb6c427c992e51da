"""Write the samples of workbooks with zipfile alone; metrosep is not imported.

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
X_MM = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]
Z_UM = [1.25, -3.5, None, 7.0, 2.0, -0.5]
DATES = '<numFmts><numFmt numFmtId="164" formatCode="dd/mm/yyyy\\ hh:mm:ss.000"/></numFmts>'


def cell(place, value):
    """Return a cell: a text, a number, a number shown as a moment (a pair), or an error by its sign."""
    if value is None:
        return ""
    if isinstance(value, tuple):
        return f'<c r="{place}" s="1"><v>{value[0]!r}</v></c>'
    if isinstance(value, str) and value.startswith("#"):
        return f'<c r="{place}" t="e"><v>{value}</v></c>'
    if isinstance(value, str):
        return f'<c r="{place}" t="inlineStr"><is><t>{value}</t></is></c>'
    return f'<c r="{place}"><v>{value!r}</v></c>'


def workbook(**sheets):
    """Return a workbook; each sheet is a list of rows, a row a list of values."""
    members = {
        "[Content_Types].xml": "<Types/>",
        "xl/styles.xml": f'<styleSheet {MAIN}>{DATES}<cellXfs><xf numFmtId="0"/>'
        '<xf numFmtId="164"/></cellXfs></styleSheet>',
    }
    listed, related = [], []
    for k, (name, rows) in enumerate(sheets.items(), start=1):
        listed.append(f'<sheet name="{name}" sheetId="{k}" r:id="rId{k}"/>')
        related.append(
            f'<Relationship Id="rId{k}" Type="{RELATIONS}/worksheet" Target="worksheets/sheet{k}.xml"/>'
        )
        body = "".join(
            f'<row r="{n}">{"".join(cell(f"{chr(65 + c)}{n}", v) for c, v in enumerate(row))}</row>'
            for n, row in enumerate(rows, start=1)
        )
        members[f"xl/worksheets/sheet{k}.xml"] = (
            f"<worksheet {MAIN}><sheetData>{body}</sheetData></worksheet>"
        )
    members["xl/workbook.xml"] = (
        f'<workbook {MAIN} xmlns:r="{RELATIONS}"><sheets>{"".join(listed)}</sheets></workbook>'
    )
    members["xl/_rels/workbook.xml.rels"] = (
        f'<Relationships xmlns="{PACKAGE}">{"".join(related)}</Relationships>'
    )
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, text in members.items():
            info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            info.create_system = 3
            info.compress_type = zipfile.ZIP_STORED  # deflate may differ between versions of zlib
            archive.writestr(info, text.encode())
    return stream.getvalue()


TABLE = [["Straightness of X"], [], ["x [mm]", "z [um]"], *map(list, zip(X_MM, Z_UM, strict=True))]
FAULTS = [[*row[:-1], "#DIV/0!"] if row and row[-1] is None else row for row in TABLE]
TEXTS = [
    *TABLE[:3],
    *([x, str(z).replace(".", ",")] for x, z in zip(X_MM, [1.25, *X_MM[1:]], strict=True)),
]
CLOCK = [["time", "gap_nm"], *([(46086.5 + k / 172800.0,), 10.0 * k] for k in range(4))]
OTHER = [["no", "gauge"], [1, "A"]]
PROFILE = {
    "kind": "profile",
    "shape": [6],
    "x_m": [x * 1e-3 for x in X_MM],
    "z_m": [None if z is None else z * 1e-6 for z in Z_UM],
}
CASES = {
    "profile.xlsx": (workbook(Straightness=TABLE, Remarks=[["none"]]), PROFILE),
    "error-cell.xlsx": (workbook(Data=FAULTS), PROFILE),
    "texts.xlsx": (
        workbook(Data=TEXTS),
        {
            **PROFILE,
            "z_m": [v * 1e-6 for v in [1.25, *X_MM[1:]]],
            "warnings_match": "read with a decimal comma",
        },
    ),
    "clock.xlsx": (
        workbook(Data=CLOCK),
        {
            "kind": "recording",
            "t_s": [0.5 * k for k in range(4)],
            "channels": {"gap_nm": [k * 1e-8 for k in range(4)]},
        },
    ),
    "chosen.xlsx": (workbook(Gauges=OTHER, Data=TABLE), {**PROFILE, "options": {"sheet": "Data"}}),
    "two-sheets.xlsx": (
        workbook(Gauges=OTHER, Data=TABLE),
        {"error": "FormatMismatchError", "match": "'Data' (11 numbers); choose one with sheet="},
    ),
    "odd-cell.xlsx": (
        workbook(Data=[*TABLE[:5], [0.75, "broken"], *TABLE[5:]]),
        {"error": "CorruptFileError", "match": "odd-cell.xlsx, worksheet 'Data': column 'z [um]'"},
    ),
    "cut-off.xlsx": (
        workbook(Data=TABLE)[:-40],
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
