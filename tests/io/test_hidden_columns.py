"""A hidden column of a worksheet is often one that somebody meant to leave out: it is read, and named."""

import zipfile

import pytest

import metrosep as ms

ROWS = [(0.25 * k, 0.1 * k % 0.7, 5.0 + k) for k in range(12)]
NAMES = ("x_mm", "z_um", "old_um")


def xlsx(path, hidden):
    book = pytest.importorskip("openpyxl").Workbook()
    for row in (NAMES, *ROWS):
        book.active.append(row)
    for letter in hidden:
        book.active.column_dimensions[letter].hidden = True
    book.save(path)


def ods(path, hidden):
    short = {"office": "office", "table": "table", "text": "text"}
    spaces = " ".join(
        f'xmlns:{k}="urn:oasis:names:tc:opendocument:xmlns:{v}:1.0"' for k, v in short.items()
    )
    collapsed = ' table:visibility="collapse"'
    columns = (
        "".join(f"<table:table-column{collapsed * (letter in hidden)}/>" for letter in "ABC")
        + f'<table:table-column table:number-columns-repeated="9"{collapsed * ("F" in hidden)}/>'
    )
    texts = "".join(
        f'<table:table-cell office:value-type="string"><text:p>{n}</text:p></table:table-cell>'
        for n in NAMES
    )
    numbers = "".join(
        "<table:table-row>"
        + "".join(
            f'<table:table-cell office:value-type="float" office:value="{v}"><text:p>{v}</text:p></table:table-cell>'
            for v in row
        )
        + "</table:table-row>"
        for row in ROWS
    )
    with zipfile.ZipFile(path, "w") as made:
        made.writestr("mimetype", "application/vnd.oasis.opendocument.spreadsheet")
        made.writestr(
            "content.xml",
            f"<office:document-content {spaces}><office:body><office:spreadsheet>"
            f'<table:table table:name="A">{columns}<table:table-row>{texts}</table:table-row>{numbers}'
            "</table:table></office:spreadsheet></office:body></office:document-content>",
        )


@pytest.mark.parametrize("write", [xlsx, ods])
@pytest.mark.parametrize(("hidden", "said"), [("", ""), ("C", "C"), ("BC", "B, C"), ("F", "")])
def test_hidden_columns_with_numbers_are_named(tmp_path, write, hidden, said):
    path = tmp_path / f"book.{write.__name__}"
    write(path, hidden)

    read = ms.read(path, x="x_mm", z="z_um")

    assert read.z.tolist() == pytest.approx([1e-6 * z for _, z, _ in ROWS], rel=0.0, abs=1e-18)
    warnings = " ".join(read.metadata["warnings"])
    assert (f"column(s) {said} are hidden" in warnings) == bool(said)
    assert ("hidden" in warnings) == bool(said)
