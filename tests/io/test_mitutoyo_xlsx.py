"""Mitutoyo workbooks: printed results of the real one, units, hostile archives, damage."""

import io
import re
import time
import tracemalloc
import zipfile

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.archive import zip_members
from metrosep.io.containers.workbook import Workbook
from metrosep.io.containers.worksheets import mitutoyo_xlsx
from metrosep.io.declared import Match
from metrosep.io.source import RawFile

NM = 1e-9
UM = 1e-6
MANIFEST = 1e-6  # relative; digits of the manifest
QUICK = 2.0  # seconds; what a hostile file may take at most
SMALL = 200e6  # bytes; what a hostile file may take at most


@pytest.fixture
def samples(repository):
    return repository / "data_formats" / "mitutoyo-xlsx" / "samples"


@pytest.fixture
def repacked(samples, tmp_path):
    """Write the plain sample with members replaced, added or (None) left out."""

    def write(members, *, method=zipfile.ZIP_DEFLATED):
        path = tmp_path / "repacked.xlsx"
        with (
            zipfile.ZipFile(samples / "plain.xlsx") as old,
            zipfile.ZipFile(path, "w", method) as new,
        ):
            contents = {n: old.read(n) for n in old.namelist()} | members
            for name, data in contents.items():
                if data is not None:
                    new.writestr(name, data)
        return path

    return write


@pytest.mark.parametrize(
    ("name", "n", "dx", "pv", "sq"),
    [
        ("mitutoyo_2_mock", 6664, 1.5e-6, 22233.2, 3968.897),
        ("mitutoyo_mock", 960, 5e-7, 586.9439, 168.6633),
    ],
)
def test_real_file_as_the_manifest_gives_it(corpus, name, n, dx, pv, sq):
    profile = ms.read(corpus / "st" / f"{name}.xlsx")

    assert len(profile) == n
    assert profile.n_invalid == 0
    assert profile.dx == pytest.approx(dx, rel=MANIFEST, abs=0.0)
    assert profile.peak_to_valley() == pytest.approx(pv * NM, rel=MANIFEST, abs=0.0)
    assert profile.rms() == pytest.approx(sq * NM, rel=MANIFEST, abs=0.0)


def test_units_follow_from_the_printed_results_of_the_real_file(corpus):
    """Ra 3.308, Rq 3.959 and Rt 22.233 um are printed; the profile is already filtered (CUV R)."""
    profile = ms.read(corpus / "st" / "mitutoyo_2_mock.xlsx")

    results = profile.metadata["header"]["results"]
    assert results[:2] == ["Ra     3.308  µm", "Rq     3.959  µm"]
    assert "Rt     22.233 µm" in results
    assert np.abs(profile.z).mean() == pytest.approx(3.308 * UM, abs=0.0005 * UM)
    assert profile.peak_to_valley() == pytest.approx(22.233 * UM, abs=0.0005 * UM)
    assert len(profile) * profile.dx == pytest.approx(
        4 * 2.5e-3, rel=1e-3, abs=0.0
    )  # N 4, CUT 2.5mm
    assert profile.metadata["profile_kind"] == "R"
    assert profile.metadata["header"]["certificate"]["E48"] == "2.5mm"


def test_cells_of_the_real_file_as_openpyxl_reads_them(corpus):
    openpyxl = pytest.importorskip("openpyxl")
    path = corpus / "st" / "mitutoyo_mock.xlsx"
    sheet = openpyxl.load_workbook(path, data_only=True)["DATA"]
    truth = {
        c.coordinate: c.value for row in sheet["A1:F1000"] for c in row if c.value is not None
    }

    rows = Workbook(RawFile(path)).cells("DATA")

    ours = {
        f"{column}{n}": value for n, cells in rows for column, value in cells.items() if n < 1001
    }
    assert ours == truth


def test_step_override_is_recorded(samples):
    profile = ms.read(samples / "plain.xlsx", lateral_step="1 um")

    assert profile.dx == pytest.approx(UM, rel=MANIFEST, abs=0.0)
    assert profile.metadata["lateral_step_in_file_m"] == pytest.approx(
        1.5 * UM, rel=MANIFEST, abs=0.0
    )


def test_unit_contradicting_the_results_is_refused(samples):
    with pytest.raises(ms.errors.ReadError, match="takes no unit"):
        ms.read(samples / "plain.xlsx", unit=("mm", "nm"))


@pytest.mark.parametrize("unit", [None, "um", ("um",)])
def test_units_are_never_guessed(samples, unit):
    with pytest.raises(ms.errors.UnitError, match="unit="):
        ms.read(samples / "no-results.xlsx", unit=unit)


def test_other_workbooks_are_not_recognised(corpus, repacked):
    path = corpus / "round" / "talyrond_profile.xlsx"

    assert mitutoyo_xlsx.sniff(RawFile(path, path.read_bytes()[:65536])) is Match.NO
    with pytest.raises(ms.errors.FormatMismatchError, match="found Sheet1"):
        ms.read(path, format="mitutoyo-xlsx")


def test_text_is_not_a_workbook(put):
    with pytest.raises(ms.errors.FormatMismatchError, match="50 4b 03 04"):
        ms.read(put("1,2\n"), format="mitutoyo-xlsx")


def test_names_of_the_worksheets_are_found_packed_or_not(samples, repacked):
    for path in (samples / "plain.xlsx", repacked({})):
        whole, cut = RawFile(path), RawFile(path, path.read_bytes()[:-40])
        assert "DATA" in Workbook(whole).names
        assert "xl/workbook.xml" in zip_members(whole)
        assert list(zip_members(cut)) == list(zip_members(whole))
        assert len(ms.read(path)) == 4


def sheet(body):
    return f"<worksheet><sheetData>{body}</sheetData></worksheet>"


LAUGHS = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10 if i else "ha"}">' for i in range(10))


@pytest.mark.parametrize(
    ("data", "match"),
    [
        (b"<a>" * 2**22, "not well-formed|larger"),
        (b" " * 2**25, "larger than it may be"),
        (f"<!DOCTYPE a [{LAUGHS}]><a>&e9;</a>", "document type or entities"),
        ('<!DOCTYPE a SYSTEM "http://127.0.0.1:9/x"><a/>', "document type or entities"),
        (sheet('<row r="1"><c r="E1"><v>1e999</v></c></row>'), "not finite"),
        (sheet('<row r="1"><c r="E1"><v>one</v></c></row>'), "is not a value"),
        (sheet('<row r="1"><c r="E1" t="s"><v>99999</v></c></row>'), "is not a value"),
        (sheet('<row r="1"><c r="E1" t="s"><v>-1</v></c></row>'), "is not a value"),
        (sheet('<row r="1"><c r="../E1"><v>1</v></c></row>'), "without a place"),
        (sheet("<row/>" * 200_000), "larger|holds no profile"),
        (b"", "not well-formed"),
        (b"<?xml version='1.0' encoding='none'?><a/>", "not well-formed|cannot be decoded"),
        (None, "found Certificate;"),
    ],
)
def test_hostile_worksheet_is_a_read_error(repacked, data, match):
    path = repacked({"xl/worksheets/sheet2.xml": data})
    start = time.process_time()
    tracemalloc.start()

    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(path)

    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < SMALL
    assert time.process_time() - start < QUICK


@pytest.mark.parametrize("target", ["../../../etc/passwd", "/etc/passwd", "http://127.0.0.1:9/x"])
def test_links_out_of_the_archive_are_never_followed(repacked, samples, target):
    with zipfile.ZipFile(samples / "plain.xlsx") as archive:
        links = archive.read("xl/_rels/workbook.xml.rels").decode()

    path = repacked({"xl/_rels/workbook.xml.rels": links.replace("worksheets/sheet2.xml", target)})

    with pytest.raises(ms.errors.ReadError, match="expected worksheets Certificate and DATA"):
        ms.read(path)


def test_encrypted_workbook_is_unsupported(samples, put):
    data = bytearray((samples / "plain.xlsx").read_bytes())
    at = 0
    while (at := data.find(b"PK\x01\x02", at)) >= 0:
        data[at + 8] |= 1
        at += 4

    with pytest.raises(ms.errors.UnsupportedFeatureError, match="encrypted"):
        ms.read(put(bytes(data), "a.xlsx"))


def test_size_of_the_directory_is_not_believed(samples, put):
    stream = io.BytesIO()
    with zipfile.ZipFile(samples / "plain.xlsx") as old, zipfile.ZipFile(stream, "w") as new:
        for name in old.namelist():
            new.writestr(name, old.read(name), zipfile.ZIP_DEFLATED)
    data = bytearray(stream.getvalue())
    at = data.find(b"PK\x01\x02", data.find(b"xl/sharedStrings.xml") + 1)
    while data[at + 46 : at + 66] != b"xl/sharedStrings.xml":
        at = data.find(b"PK\x01\x02", at + 4)
    data[at + 24 : at + 28] = (10).to_bytes(4, "little")

    with pytest.raises(ms.errors.CorruptFileError, match=r"sharedStrings\.xml"):
        ms.read(put(bytes(data), "a.xlsx"))


def test_damage(samples, survives_damage):
    survives_damage(mitutoyo_xlsx, samples / "plain.xlsx", every=29)


@pytest.fixture
def with_settings(samples, repacked):
    """Write the plain sample, 4 points of 1.5 um, with other texts in column B."""

    def write(*settings):
        with zipfile.ZipFile(samples / "plain.xlsx") as old:
            sheet = old.read("xl/worksheets/sheet2.xml").decode()
            strings = old.read("xl/sharedStrings.xml").decode()
        n = strings.count("<si>")
        texts = "".join(f"<si><t>{text}</t></si>" for text in settings)
        sheet = re.sub(r'<c r="B\d" t="s"><v>\d</v></c>', "", sheet)
        for k in range(len(settings)):
            cell = f'<c r="B{k + 1}" t="s"><v>{n + k}</v></c>'
            sheet = sheet.replace(f'<c r="C{k + 1}">', f'{cell}<c r="C{k + 1}">')
        return repacked(
            {
                "xl/worksheets/sheet2.xml": sheet.encode(),
                "xl/sharedStrings.xml": strings.replace("</sst>", texts + "</sst>").encode(),
            }
        )

    return write


def test_cut_offs_and_sections_of_the_real_file(corpus):
    """CUT 2.5mm, N 4, LS 8 um stand in it; 4 x 2.5 mm are its length but for a step a section."""
    metadata = ms.read(corpus / "st" / "mitutoyo_2_mock.xlsx").metadata

    assert metadata["lambda_c_m"] == 2.5e-3
    assert metadata["lambda_s_m"] == pytest.approx(8 * UM, rel=1e-15, abs=0.0)
    assert metadata["n_sections"] == 4
    assert metadata["warnings"] == ()


def test_a_file_without_settings_declares_none(corpus):
    metadata = ms.read(corpus / "st" / "mitutoyo_mock.xlsx").metadata

    assert not {"lambda_c_m", "lambda_s_m", "n_sections"} & set(metadata)


def test_sections_other_than_those_of_the_cut_off_deserve_a_note(corpus):
    profile = ms.read(corpus / "st" / "mitutoyo_2_mock.xlsx")

    five = ms.parameters.profile_parameters(profile, kind="R", names=["Rz"])
    four = ms.parameters.profile_parameters(profile, kind="R", names=["Rz"], sections=4)

    assert any("2.5 mm" in n and "sections=4" in n for n in five.context.notes)
    assert not any("lambda_c" in n for n in four.context.notes)
    assert four["Rz"].value == pytest.approx(18.485 * UM, abs=0.0006 * UM)


@pytest.mark.parametrize("curve", ["CUV P", "CUV DF", "CUV"])
def test_a_cut_off_that_was_not_applied_is_not_declared(with_settings, curve):
    metadata = ms.read(with_settings("CUT 2.5mm", "N 4", curve)).metadata

    assert not {"lambda_c_m", "n_sections"} & set(metadata)
    assert metadata["header"]["settings"] == ["CUT 2.5mm", "N 4", curve]


@pytest.mark.parametrize(
    "setting",
    ["CUT 0.25", "CUT x", "CUT 0mm", "CUT -1mm", "CUT", "CUT 1e999mm", "N x", "N 0", "N 1.5"],
)
def test_a_setting_that_is_not_understood_is_a_warning(with_settings, setting):
    metadata = ms.read(with_settings(setting, "CUV R")).metadata

    assert not {"lambda_c_m", "n_sections"} & set(metadata)
    assert metadata["profile_kind"] == "R"
    assert [w for w in metadata["warnings"] if repr(setting) in w]


@pytest.mark.parametrize(
    ("cut", "n", "fits"),
    [
        ("3um", 2, True),
        ("3um", 5, False),
        ("2.5mm", 4, False),
        ("3.5um", 2, True),
        ("6um", 1, True),
    ],
)
def test_sections_that_do_not_make_the_profile_are_a_warning(with_settings, cut, n, fits):
    metadata = ms.read(with_settings(f"CUT {cut}", f"N {n}", "CUV R")).metadata

    assert metadata["n_sections"] == n
    assert any("sections of CUT" in w for w in metadata["warnings"]) is not fits


def test_a_filter_that_is_switched_off_is_no_cut_off(with_settings):
    metadata = ms.read(with_settings("LS NONE", "CUV R")).metadata

    assert "lambda_s_m" not in metadata
    assert metadata["warnings"] == ()
