"""metrosep geometry, its recipe, batch and workbench: files as instruments write them, signs planted.

The files are written here, with decimal commas, other orders of columns and empty cells; the truth is
worked out from shifts and tilts by hand.
"""

import importlib.util
import json

import numpy as np
import pytest
from scipy.optimize import linprog

import metrosep as ms
from metrosep.cli.geometry import GEOMETRY
from metrosep.core.methods import METHODS
from metrosep.recipe.pipeline import MEASURING

UM = 1e-6
CLOSE = 1e-9
"""m: second order of tilts of some 1e-4 over a radius of 12 mm is below."""
EXACT = 1e-12
"""m: two ways to write the same points, with 9 decimals of a millimetre."""

ANGLES = np.arange(0, 360, 7.5)


def circle(height, centre=(0.0, 0.0), radius=12.0, form=0.0):
    """Points of a section in mm; `form` is added to the radius, mm."""
    a = np.radians(ANGLES)
    r = radius + form
    return np.stack([centre[0] + r * np.cos(a), centre[1] + r * np.sin(a), 0 * a + height], 1)


def semicolons(path, rows, header):
    """Write a table as a German spreadsheet does."""
    lines = [";".join(header)]
    for row in rows:
        cells = [v if isinstance(v, str) else "" if np.isnan(v) else f"{v:.9f}" for v in row]
        lines.append(";".join(c.replace(".", ",") for c in cells))
    path.write_bytes(("\r\n".join(lines) + "\r\n").encode("cp1252"))
    return path


def elements(path, **parts):
    """Write points of several elements, shuffled, with the columns in an odd order."""
    rows = [(n, p[2], p[0], p[1]) for n, points in parts.items() for p in points]
    order = np.random.default_rng(1).permutation(len(rows))
    header = ("Element", "Z [mm]", "X [mm]", "Y [mm]")
    return semicolons(path, [rows[i] for i in order], header)


XYZ = ("--x", "X [mm]", "--y", "Y [mm]", "--z", "Z [mm]", "--element", "Element")


def values(call, *words):
    code, out, err = call(*words, "--json")
    assert out, err
    found = {c["metric"]: c for c in json.loads(out)["characteristics"]}
    return code, found


def test_every_step_of_geometry_is_listed():
    of_points = {n for n, m in METHODS.items() if m.verb == "geometry"}
    assert set(GEOMETRY) == of_points | {"step_height", "surface_profile", "line_profile"}
    assert set(GEOMETRY) - of_points <= set(MEASURING)


# ---- traces of a roundness instrument ----------------------------------------------------------


def traces(folder, *, mirrored=False):
    """Five traces of a tapered, oval cylinder whose axis leans: one file each, deviations in um."""
    files, points, heights = [], [], [0, 8, 16, 24, 32]
    for k, h in enumerate(heights):
        form = 0.002 * np.cos(2 * np.radians(ANGLES)) + 0.001 * h / 32
        xyz = circle(h, (0.004 - 1e-4 * h, 2e-4 * h), form=form)
        points.append(xyz)
        a = np.degrees(np.arctan2(xyz[:, 1], xyz[:, 0])) % 360
        dev = 1e3 * (np.hypot(xyz[:, 0], xyz[:, 1]) - 12.0)
        rows = list(zip(-a if mirrored else a, dev, strict=True))
        rows.insert(3, (a[0], np.nan))  # a reading that was lost
        files.append(semicolons(folder / f"t{k}.txt", rows, ("Winkel [deg]", "Abw. [um]")))
    return files, np.concatenate(points), heights


def test_traces_in_files_are_the_same_as_their_points(metrosep, tmp_path):
    files, points, heights = traces(tmp_path)
    words = ("--angle", "Winkel [deg]", "--radius", "Abw. [um]", "--set", "nominal_radius=12 mm")
    place = ("--set", "heights=" + ",".join(f"{h} mm" for h in heights))
    code, polar = values(metrosep, "geometry", "cylindricity", *files, *words, *place)
    list_ = elements(tmp_path / "points.csv", A=points)
    _, cartesian = values(metrosep, "geometry", "cylindricity", list_, *XYZ)
    assert code == 0
    assert abs(polar["CYLt"]["value"] - cartesian["CYLt"]["value"]) < EXACT
    # oval of +-2 um and a taper of 1 um: not more than both
    assert 4 * UM < polar["CYLt"]["value"] < 5.01 * UM
    assert "ISO 12180-1" in polar["CYLt"]["definition"]

    _, found = values(
        metrosep, "geometry", "run_out", *files, *words, *place, "--set", "datum=frame"
    )
    sections = points.reshape(len(heights), -1, 3)
    radii = np.hypot(sections[:, :, 0], sections[:, :, 1])
    assert abs(found["CRO"]["value"] - 1e-3 * np.ptp(radii, axis=1).max()) < EXACT
    assert abs(found["TRO"]["value"] - 1e-3 * np.ptp(radii)) < EXACT


def test_the_order_of_heights_is_the_order_of_the_files(metrosep, tmp_path):
    """Swapping two heights bends the axis: the cylinder is no cylinder any more."""
    files, _, heights = traces(tmp_path)
    words = ("--angle", "Winkel [deg]", "--radius", "Abw. [um]", "--set", "nominal_radius=12 mm")
    right, wrong = (
        values(metrosep, "geometry", "cylindricity", *files, *words, "--set", f"heights={text}")[1]
        for text in (
            ",".join(f"{h} mm" for h in heights),
            ",".join(f"{h} mm" for h in (0, 16, 8, 24, 32)),
        )
    )
    assert wrong["CYLt"]["value"] > right["CYLt"]["value"] + 0.5 * UM


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "nominal_radius"),
        (("--set", "nominal_radius=12 mm", "--set", "heights=0 mm"), "1 values for 5 file"),
        (("--set", "nominal_radius=1 um"), "leave --set nominal_radius"),
        (("--set", "nominal_radius=12 mm"), "angle, radius and height"),
    ],
)
def test_what_traces_lack_is_said(metrosep, tmp_path, words, message):
    files, _, heights = traces(tmp_path)
    if "heights" not in " ".join(words) and message != "angle, radius and height":
        words = (*words, "--set", "heights=" + ",".join(f"{h} mm" for h in heights))
    code, out, err = metrosep(
        "geometry", "cylindricity", *files, "--angle", "Winkel [deg]", "--radius", "Abw. [um]", *words
    )  # fmt: skip
    assert (code, out) in ((2, ""), (4, ""))
    assert message in err


# ---- roundness of traces -----------------------------------------------------------------------

TRACE = ("--angle", "Winkel [deg]", "--radius", "Abw. [um]")


def trace(turned=0.0, lobes=2.0, off=5.0):
    """Angle in degrees and deviation in um: three lobes, a centre `off` um away at 30 degrees."""
    a = np.arange(0.0, 360.0, 0.5)
    return a, off * np.cos(np.radians(a - 30.0)) + lobes * np.cos(3.0 * np.radians(a - turned))


@pytest.mark.parametrize("way", ["forwards", "backwards", "through zero"])
def test_a_trace_has_its_roundness_and_its_centre_however_it_was_run(metrosep, tmp_path, way):
    """Three lobes of +-2 um: RONt 4 um, RONq 2/sqrt(2) um, whatever the centre (limacon, closed form)."""
    a, r = trace()
    k = {"forwards": slice(None), "backwards": slice(None, None, -1)}.get(way)
    rows = list(
        zip(np.roll(a, 123), np.roll(r, 123), strict=True)
        if k is None
        else zip(a[k], r[k], strict=True)
    )
    rows.insert(7, (rows[7][0], np.nan))
    file = semicolons(tmp_path / "t.txt", rows, ("Winkel [deg]", "Abw. [um]"))
    words = ("--set", "reference=LS", "-o", str(tmp_path / "out"))
    code, found = values(metrosep, "geometry", "roundness", file, *TRACE, *words)
    assert code == 0
    assert abs(found["RONt"]["value"] - 4 * UM) < CLOSE
    assert abs(found["RONq"]["value"] - 2 * UM / np.sqrt(2.0)) < CLOSE
    assert "ISO 12181-1" in found["RONt"]["definition"]
    document = json.loads((tmp_path / "out" / "result.json").read_text())
    (panel,) = document["separation"]["charts"][0]["panels"]
    assert "RONt 4 um, centre 5 um off at 30 deg" in panel["title"]
    assert max(panel["curves"][0]["y"]) == pytest.approx(2 * UM, abs=CLOSE)


@pytest.mark.parametrize("reference", ["LS", "MZ"])
def test_a_wave_at_a_cutoff_keeps_half_of_its_amplitude(metrosep, tmp_path, reference):
    """In undulations per revolution: 2^-((n/upr)^2) stays, less 2^-((n/low)^2); the centre stays whole."""
    a = np.arange(0.0, 360.0, 0.5)
    for n, upr, low in (
        (15, 15, None),
        (50, 50, None),
        (150, 150, None),
        (15, 150, 15),
        (30, 50, 15),
        (3, None, 15),
    ):
        r = 5.0 * np.cos(np.radians(a - 30.0)) + 2.0 * np.cos(n * np.radians(a) + 0.4)
        file = semicolons(
            tmp_path / "t.txt", zip(a, r, strict=True), ("Winkel [deg]", "Abw. [um]")
        )
        words = ["--set", f"reference={reference}", "-o", str(tmp_path / f"{n}{upr}{low}")]
        words += [
            w for k, v in (("upr", upr), ("upr_low", low)) if v for w in ("--set", f"{k}={v}")
        ]
        code, found = values(metrosep, "geometry", "roundness", file, *TRACE, *words)
        assert code == 0
        kept = (2.0 ** -((n / upr) ** 2) if upr else 1.0) - (
            2.0 ** -((n / low) ** 2) if low else 0.0
        )
        # of 720 readings: the crest of a fast wave lies up to half a step beside a reading
        missed = 4 * UM * kept * (1.0 - np.cos(n * np.pi / 720))
        assert abs(found["RONt"]["value"] - 4 * UM * kept) < missed + CLOSE
        assert abs(found["RONq"]["value"] - np.sqrt(2.0) * UM * kept) < (
            CLOSE if reference == "LS" else missed + CLOSE
        )
        text = (tmp_path / f"{n}{upr}{low}" / "result.json").read_text()
        assert "centre 5 um off at 30 deg" in text
        assert f"Gaussian filter, {low or 1} to {upr or 359} UPR (ISO 12181-2)" in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ("upr=400",),
            "upr must be between 1 and 359.5, got 400.0; 720 readings hold waves up to 359",
        ),
        (("upr=15", "upr_low=50"), "upr_low=50 must be smaller than --set upr=15"),
        (("upr=0.5",), "upr must be between 1 and 359.5, got 0.5"),
    ],
)
def test_a_cutoff_that_the_readings_do_not_hold_is_refused(metrosep, tmp_path, words, said):
    file = semicolons(
        tmp_path / "t.txt", zip(*trace(), strict=True), ("Winkel [deg]", "Abw. [um]")
    )
    given = [w for word in words for w in ("--set", word)]
    code, _, err = metrosep("geometry", "roundness", file, *TRACE, *given)
    assert code not in (0, 1)
    assert said in " ".join(err.split())


def test_a_filter_needs_equal_angles_and_says_so(metrosep, tmp_path):
    a, r = trace()
    rows = [row for k, row in enumerate(zip(a, r, strict=True)) if k != 200]
    file = semicolons(tmp_path / "t.txt", rows, ("Winkel [deg]", "Abw. [um]"))
    code, _, err = metrosep("geometry", "roundness", file, *TRACE, "--set", "upr=50")
    assert code not in (0, 1)
    assert "readings at equal angles over a whole turn; the steps are 0.5 to 1 deg" in " ".join(
        err.split()
    )


def test_the_worst_section_counts_and_a_limit_judges_it(metrosep, tmp_path):
    files = [
        semicolons(tmp_path / f"s{k}.txt", zip(*trace(lobes=lobes), strict=True), ("Winkel [deg]", "Abw. [um]"))
        for k, lobes in enumerate((0.5, 2.0, 1.0))
    ]  # fmt: skip
    words = ("--upper", "3.9 um", "--U", "10 nm", "--set", "u_reading=1 nm")
    code, found = values(metrosep, "geometry", "roundness", *files, *TRACE, *words)
    assert code == 1
    assert abs(found["RONt"]["value"] - 4 * UM) < CLOSE
    assert 0.5e-9 < found["RONt"]["u"] < 3e-9


def heights_file(path, k=1.0, noise=0.0, off=5.0):
    a, r = trace(lobes=k, off=off)
    h = 10.0 + noise * np.random.default_rng(4).normal(size=a.size)
    path.parent.mkdir(exist_ok=True)
    return semicolons(path, zip(a, r, h, strict=True), (*TRACE[1::2], "h [mm]"))


def test_the_same_height_in_two_files_is_two_sections(metrosep, tmp_path):
    """There and back, 50 um apart in their centres: joined they had 53 um."""
    files = [heights_file(tmp_path / n / "t.txt", off=o) for n, o in (("a", 5.0), ("b", 55.0))]
    files += [heights_file(tmp_path / "back.txt", k=2.0)]
    words = ("--height", "h [mm]", "-o", str(tmp_path / "out"))
    _, found = values(metrosep, "geometry", "roundness", *files, *TRACE, *words)
    assert abs(found["RONt"]["value"] - 4 * UM) < CLOSE
    document = json.loads((tmp_path / "out" / "result.json").read_text())
    titles = [p["title"] for p in document["separation"]["charts"][0]["panels"]]
    names = [t.partition(":")[0] for t in titles]
    assert names == ["t, 10 mm", "t (2), 10 mm", "back, 10 mm"]


def test_heights_with_noise_are_sections_by_the_gap_that_is_asked_for(metrosep, tmp_path):
    file = heights_file(tmp_path / "t.txt", k=2.0, noise=2e-4)
    words = ("geometry", "roundness", file, *TRACE, "--height", "h [mm]")
    code, _, err = metrosep(*words)
    assert code == 2
    assert "state --set section_gap=" in err
    _, found = values(metrosep, *words, "--set", "section_gap=0.1 mm")
    assert abs(found["RONt"]["value"] - 4 * UM) < CLOSE


def test_rounding_is_no_eccentricity_and_zero_has_no_sign(metrosep, tmp_path):
    for off, said in ((0.0, "eccentricity 0 m"), (1e-6, "eccentricity 1 pm")):
        file = semicolons(tmp_path / "t.txt", zip(*trace(off=off), strict=True), TRACE[1::2])
        code, out, err = metrosep("geometry", "roundness", file, *TRACE, "--set", "reference=MI")
        assert code == 0
        assert "RONv: 0 m" in out + err
        code, out, err = metrosep("geometry", "roundness", file, *TRACE, "--set", "reference=LS")
        assert said in out + err


def test_what_an_exact_circle_needs_is_the_option_of_this_step(metrosep, tmp_path):
    """The column of the readings is called radius here, so the option cannot be."""
    file = semicolons(tmp_path / "t.txt", zip(*trace(), strict=True), TRACE[1::2])
    radii = semicolons(
        tmp_path / "r.txt", ((a, 25e3 + r) for a, r in zip(*trace(), strict=True)), TRACE[1::2]
    )
    exact = ("geometry", "roundness", file, *TRACE, "--set", "exact=true")
    for words, says in (
        (exact, "needs --set nominal_radius="),
        (("geometry", "roundness", radii, *TRACE, "--set", "nominal_radius=25 mm"), "leave --set nominal_radius="),
    ):  # fmt: skip
        code, _, err = metrosep(*words)
        assert code == 2
        assert says in err
    code, found = values(metrosep, *exact, "--set", "nominal_radius=25 mm")
    assert code == 0
    assert abs(found["RONt"]["value"] - 4 * UM) < 1e-9  # e^2/(2 R) is 0.5 nm
    code, found = values(metrosep, "geometry", "roundness", radii, *TRACE, "--set", "reference=LS")
    assert abs(found["RONt"]["value"] - 4 * UM) < CLOSE


def test_a_trace_of_a_talyrond_worksheet_is_a_table(metrosep, corpus):
    """Radius over the angle, no unit in the file: the sheet has 3600 rows of 0.1 degrees, without names."""
    file = corpus / "round" / "talyrond_profile.xlsx"
    words = ("--angle", "column1:deg", "--radius", "column2:um", "--set", "reference=LS")
    _, found = values(metrosep, "geometry", "roundness", file, *words)
    a, r = np.array(sheet(file)).T
    G = np.stack([np.ones(a.size), np.cos(np.radians(a)), np.sin(np.radians(a))], 1)
    truth = np.ptp(r - G @ np.linalg.lstsq(G, r)[0])
    assert abs(found["RONt"]["value"] - truth * UM) < CLOSE


def sheet(file):
    """Columns A and B of the first worksheet, read without metrosep."""
    import re
    import zipfile

    with zipfile.ZipFile(file) as book:
        name = next(n for n in sorted(book.namelist()) if "worksheets/sheet" in n)
        text = book.read(name).decode()
    cells = dict(re.findall(r'<c r="([AB]\d+)"[^>]*?><v>([^<]+)</v>', text))
    return [(float(cells[f"A{k}"]), float(cells[f"B{k}"])) for k in range(1, len(cells) // 2 + 1)]


# ---- position and run-out against another element -----------------------------------------------


def journals(folder, shift):
    """Journal A from z = 0 to 20 leans by +1e-4 in x and -2e-4 in y; B at z = 60 to 80 is `shift` mm off."""
    lean = lambda h: (1e-4 * h, -2e-4 * h)  # noqa: E731
    A = np.concatenate([circle(h, lean(h), 10.0) for h in (0, 10, 20)])
    B = np.concatenate([circle(h, np.add(lean(h), shift), 8.0) for h in (60, 70, 80)])
    return elements(folder / "journals.csv", A=A, B=B)


@pytest.mark.parametrize("shift", [(0.003, 0.0), (-0.003, 0.0), (0.0, 0.004)])
def test_coaxiality_goes_on_along_the_leaning_datum(metrosep, tmp_path, shift):
    file = journals(tmp_path, shift)
    words = (*XYZ, "--set", "datum=A", "--set", "section_gap=1 mm")
    _, found = values(metrosep, "geometry", "coaxiality", file, *words)
    assert abs(found["COX"]["value"] - 2e-3 * np.hypot(*shift)) < CLOSE
    _, turned = values(metrosep, "geometry", "run_out", file, *words)
    assert abs(turned["CRO"]["value"] - 2e-3 * np.hypot(*shift)) < CLOSE


def test_the_other_way_round_the_datum_is_another(metrosep, tmp_path):
    """About B the far end of A is off as well: 2 x 3 um, B is straight and leans as A does."""
    A = np.concatenate([circle(h, (1e-4 * h, 0.0), 10.0) for h in (0, 10, 20)])
    B = np.concatenate([circle(h, (0.0, 0.0), 8.0) for h in (60, 70, 80)])
    file = elements(tmp_path / "j.csv", A=A, B=B)
    words = (*XYZ, "--set", "section_gap=1 mm", "--set")
    _, about_a = values(metrosep, "geometry", "coaxiality", file, *words, "datum=A")
    _, about_b = values(metrosep, "geometry", "coaxiality", file, *words, "datum=B")
    assert abs(about_a["COX"]["value"] - 2 * 8 * UM) < CLOSE  # at z = 80: A's axis is at 8 um
    assert abs(about_b["COX"]["value"] - 2 * 2 * UM) < CLOSE  # at z = 20: 2 um from B's


# ---- faces ---------------------------------------------------------------------------------------


def face(slope_x=0.0, bowl=0.0, height=0.0):
    """Points of a face over 40 mm x 30 mm, in mm; a bowl is deepest in the middle."""
    X, Y = (v.ravel() for v in np.meshgrid(np.linspace(0, 40, 9), np.linspace(0, 30, 7)))
    dent = bowl * (((X - 20) / 20) ** 2 - 1)
    return np.stack([X, Y, height + slope_x * X + dent], 1)


@pytest.mark.parametrize(("top", "value"), [(2e-4, 4.0), (1e-4, 0.0), (0.0, 4.0), (-1e-4, 8.0)])
def test_parallelism_to_a_leaning_face(metrosep, tmp_path, top, value):
    file = elements(tmp_path / "f.csv", A=face(1e-4), B=face(top, height=20))
    words = (*XYZ, "--set", "datum=A")
    _, found = values(metrosep, "geometry", "parallelism", file, *words)
    assert abs(found["PAR"]["value"] - value * UM) < CLOSE
    _, swapped = values(metrosep, "geometry", "parallelism", file, *XYZ, "--set", "datum=B")
    assert abs(swapped["PAR"]["value"] - value * UM) < CLOSE


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_datum_rests_on_what_stands_out(metrosep, tmp_path, side):
    """A lip of 3 um at x < 10 mm rocks the datum plane: by the minimax plane of scipy, not by LS."""
    datum = face()
    datum[:, 2] += side * 0.003 * np.clip((10 - datum[:, 0]) / 10, 0, 1)
    A = np.column_stack([np.ones(len(datum)), datum[:, :2]])
    one = np.ones((len(A), 1))
    best = linprog(
        [0, 0, 0, 1], np.block([[A, -one], [-A, -one]]), np.r_[datum[:, 2], -datum[:, 2]],
        bounds=[(None, None)] * 4,
    ).x  # fmt: skip
    file = elements(tmp_path / "f.csv", A=datum, B=face(height=20))
    tangent, least = (
        values(metrosep, "geometry", "parallelism", file, *XYZ, "--set", "datum=A", "--set", f"association={a}")[1]["PAR"]
        for a in ("tangent", "LS")
    )  # fmt: skip
    assert abs(tangent["value"] - 40e-3 * abs(best[1])) < CLOSE
    assert abs(least["value"] - tangent["value"]) > 0.3 * UM
    assert "tangent" in tangent["definition"]


def wall(lean=0.0, yaw=0.0):
    """A wall at x = 0 over y, z: it leans by `lean` along z and is turned by `yaw` about z."""
    Y, Z = (v.ravel() for v in np.meshgrid(np.linspace(0, 30, 7), np.linspace(0, 20, 6)))
    return np.stack([lean * Z + yaw * Y, Y, Z], 1)


@pytest.mark.parametrize(("lean", "value"), [(-1e-4, 0.0), (1e-4, 4.0), (0.0, 2.0)])
def test_perpendicularity_of_a_wall(metrosep, tmp_path, lean, value):
    """The floor rises along +x by 1e-4, so a square wall leans by -1e-4; yaw does not matter."""
    file = elements(tmp_path / "f.csv", A=face(1e-4), W=wall(lean, yaw=3e-3))
    words = (*XYZ, "--set", "datum=A")
    _, found = values(metrosep, "geometry", "perpendicularity", file, *words)
    assert abs(found["PER"]["value"] - value * UM) < 20 * CLOSE  # yaw and lean mix: 3e-3 x 2 um


def test_a_face_beside_a_bore_needs_no_sections(metrosep, tmp_path):
    """The column section is filled for the bore only; a hole in it is refused with its element."""
    bore = [("P", f"s{h}", *p) for h in (0, 10, 20) for p in circle(h, (-30, 0), 4.0)]
    rows = bore + [("A", "", *p) for p in face(1e-4)]
    header = ("Element", "Ebene", "X [mm]", "Y [mm]", "Z [mm]")
    words = ("geometry", "perpendicularity", *XYZ, "--section", "Ebene")
    words += ("--set", "feature=A", "--set", "datum=P", "--set", "datum_kind=axis")

    file = semicolons(tmp_path / "f.csv", rows, header)
    _, found = values(metrosep, *words, file)
    assert abs(found["PER"]["value"] - 4.0 * UM) < CLOSE

    rows[5] = ("P", "", *bore[5][2:])
    code, _, err = metrosep(*words, semicolons(tmp_path / "g.csv", rows, header))
    assert code == 2
    assert "a point of element P has no entry in the column section" in err


@pytest.mark.parametrize(
    ("what", "own", "value"),
    [
        # the hole through the plate: leans by 3e-4 in x against the floor that rises by 1e-4
        ("perpendicularity", ("feature=H", "feature_kind=axis", "datum=A"), 20 * 0.4),
        (
            "parallelism",
            ("feature=H", "feature_kind=axis", "datum=P", "datum_kind=axis"),
            20 * 0.3,
        ),
        # the floor against the upright axis P: rises by 1e-4 over 40 mm
        ("perpendicularity", ("feature=A", "datum=P", "datum_kind=axis"), 40 * 0.1),
        # the wall leans along P by 2e-4 over 20 mm; it may turn about P
        ("parallelism", ("feature=W", "datum=P", "datum_kind=axis"), 20 * 0.2),
    ],
)
def test_axes_and_planes_in_all_pairs(metrosep, tmp_path, what, own, value):
    hole = np.concatenate([circle(h, (5 + 3e-4 * h, 0), 4.0) for h in (0, 10, 20)])
    pin = np.concatenate([circle(h, (-30, 0), 4.0) for h in (0, 10, 20)])
    file = elements(tmp_path / "f.csv", A=face(1e-4), H=hole, P=pin, W=wall(2e-4, 3e-3))
    words = [w for text in own for w in ("--set", text)]
    code, out, err = metrosep(
        "geometry", what, file, *XYZ, "--set", "section_gap=1 mm", *words, "--json"
    )
    assert code == 0, err
    (entry,) = json.loads(out)["characteristics"]
    assert abs(entry["value"] - value * UM) < 20 * CLOSE


# ---- verdicts, uncertainty, reports, refusals ----------------------------------------------------


@pytest.mark.parametrize(
    ("own", "code", "verdict"),
    [
        (("--upper", "5 um"), 3, "inconclusive"),
        (("--upper", "5 um", "--U", "0.3 um"), 0, "accept"),
        (("--upper", "4.2 um", "--U", "0.3 um"), 3, "inconclusive"),
        (("--upper", "3 um", "--U", "0.3 um"), 1, "reject"),
        (("--upper", "4.2 um", "--set", "u_reading=10 nm"), 0, "accept"),
    ],
)
def test_a_limit_and_its_verdict(metrosep, tmp_path, own, code, verdict):
    file = elements(tmp_path / "f.csv", A=face(), B=face(1e-4, height=20))
    words = (*XYZ, "--set", "datum=A", *own)
    found, _, err = metrosep("geometry", "parallelism", file, *words)
    assert found == code, err
    assert f"verdict: {verdict}" in err
    if own == ("--upper", "5 um"):
        assert "state it: U" in err
    if "u_reading=10 nm" in own:
        assert "also lifts the values, PAR by" in err


def test_u_of_independent_readings_is_their_scatter(metrosep, tmp_path):
    """Two single points hold the zone along z: u is sqrt(2) times that of one, and noise lifts it."""
    flat = face()
    flat[[0, -1], 2] += (0.002, -0.003)
    file = elements(tmp_path / "f.csv", A=face(height=-20), B=flat)
    words = (*XYZ, "--set", "datum=A", "--set", "association=LS")
    _, found = values(
        metrosep, "geometry", "parallelism", file, *words, "--set", "u_reading=20 nm"
    )
    entry = found["PAR"]
    assert entry["value"] == pytest.approx(5 * UM, rel=0.0, abs=CLOSE)
    assert entry["u"] == pytest.approx(np.sqrt(2) * 20e-9, rel=0.25, abs=0.0)  # 100 draws: 7 %
    assert entry["u_source"] == "u_reading, Monte Carlo"


def test_report_result_and_points_are_written(metrosep, tmp_path):
    file = journals(tmp_path, (0.003, 0.0))
    out = tmp_path / "out"
    code, _, err = metrosep(
        "geometry", "run_out", file, *XYZ, "--set", "datum=A", "--set", "section_gap=1 mm",
        "--upper", "CRO=10 um", "--upper", "TRO=3 um", "--U", "CRO=1 um", "--U", "TRO=1 um", "-o", out,
    )  # fmt: skip
    assert code == 1, err
    document = json.loads((out / "result.json").read_text("utf-8"))
    verdicts = {c["metric"]: c["verdict"] for c in document["characteristics"]}
    assert verdicts == {"CRO": "accept", "TRO": "reject"}
    (cro, tro) = document["separation"]["zones"]
    assert (cro["symbol"], tro["symbol"]) == ("CRO", "TRO")
    assert cro["edition"].startswith("ISO 1101:2017")
    assert len(cro["support_m"]) == 2
    report = (out / "report.html").read_text("utf-8")
    assert "circular radial run-out" in report
    assert "Deviation of the points" in report
    assert (out / "parts.csv").read_text("utf-8").count("\n") > 3 * len(ANGLES)


def test_a_recipe_is_printed_and_runs_on_a_batch(metrosep, tmp_path):
    folder = tmp_path / "parts"
    folder.mkdir()
    for k, slope in enumerate((1e-5, 3e-4)):
        elements(folder / f"part{k}.csv", A=face(), B=face(slope, height=20))
    words = (*XYZ, "--set", "datum=A", "--upper", "5 um", "--U", "0.5 um")
    code, out, _ = metrosep(
        "geometry", "parallelism", folder / "part0.csv", *words, "--print-recipe"
    )
    assert code == 0
    lines = [line for line in out.splitlines() if not line.startswith("files")]
    recipe = tmp_path / "recipe.toml"
    recipe.write_text("\n".join([*lines, "[batch]", 'each = "file"', ""]), "utf-8")
    code, _, err = metrosep(
        "batch", recipe, folder, "--scheduler", "serial", "-o", tmp_path / "out"
    )
    assert code == 1, err
    index = next((tmp_path / "out").glob("*.csv")).read_text("utf-8")
    assert "accept" in index
    assert "reject" in index


@pytest.mark.parametrize(
    ("what", "own", "message"),
    [
        ("parallelism", ("datum=L", "feature=A"), "do not lie on a face"),
        ("parallelism", ("datum=C",), "is not one of the elements (A, B, L)"),
        (
            "parallelism",
            (
                "datum=A",
                "feature=A",
            ),
            "feature and datum are both",
        ),
        ("coaxiality", ("datum=frame", "feature=A", "direction=up"), "is not a direction"),
        ("parallelism", (), 'needs the key "datum"'),
        ("cylindricity", (), "are of 3 elements"),
        ("coaxiality", ("datum=frame", "feature=A"), "needs to know the section"),
        ("cylindricity", ("feature=A",), "sections at several heights"),
        ("cylindricity", ("feature=A", "direction=x"), "determine"),
        ("cylindricity", ("radius=2 mm",), 'unknown key "radius"'),
    ],
)
def test_what_cannot_be_judged_is_one_sentence(metrosep, tmp_path, what, own, message):
    file = elements(tmp_path / "f.csv", A=face(), B=face(1e-4, height=20), L=face()[:9])
    words = [w for text in own for w in ("--set", text)]
    code, out, err = metrosep("geometry", what, file, *XYZ, *words)
    assert code in (2, 4), err
    assert out == ""
    assert message in err


def test_columns_without_unit_and_limits_of_another_kind_are_refused(metrosep, tmp_path):
    file = tmp_path / "p.csv"
    file.write_text("x,y,z\n" + "\n".join(f"{i},{i * i % 7},{i % 3}" for i in range(20)) + "\n")
    words = ("--x", "x", "--y", "y", "--z", "z")
    code, _, err = metrosep("geometry", "cylindricity", file, *words)
    assert (code, "unit" in err) == (2, True)
    code, _, err = metrosep("geometry", "cylindricity", file, "--x", "x:mm", "--y", "y:mm")
    assert code in (2, 4)
    assert "x, y and z" in err
    code, _, err = metrosep("geometry", "run_out", file, *words, "--upper", "XX=5 um")
    assert (code, "CRO, TRO" in err) == (2, True)


# ---- steps on maps and profiles -------------------------------------------------------------------


def groove_file(path, sign=-1.0, tilt=0.0, noise=2e-9):
    """A groove (or ridge) of 1 um x 100 um at x = 400 um, measured from 0 to 0.8 mm; in um and nm."""
    x = np.arange(0, 801) * 1.0
    z = sign * 1e-6 * (np.abs(x - 400) < 48) + tilt * x * UM
    z += noise * np.random.default_rng(3).standard_normal(x.size)
    z[100] = np.nan
    rows = list(zip(x, z * 1e9, strict=True))
    return semicolons(path, rows, ("Pos [um]", "Hoehe [nm]"))


@pytest.mark.parametrize(("sign", "tilt"), [(-1.0, 1e-3), (1.0, -1e-3)])
def test_depth_of_a_groove_at_the_command_line(metrosep, tmp_path, sign, tilt):
    file = groove_file(tmp_path / "g.csv", sign, tilt)
    words = (
        "--x",
        "Pos [um]",
        "--z",
        "Hoehe [nm]",
        "--set",
        "width=100 um",
        "--set",
        "middle=0.4 mm",
    )
    limits = ("--lower", "0.99 um", "--upper", "1.01 um", "--U", "from fit")
    code, found = values(metrosep, "geometry", "step_height", file, *words, *limits)
    assert code == 0
    d, h = found["d"], found["h"]
    assert abs(d["value"] - UM) < 3 * d["u"]
    assert h["value"] * sign == pytest.approx(d["value"], rel=1e-12, abs=0.0)
    assert (
        d["u"] < 1.1e-9
    )  # it is 1.03 nm: the eight polynomials of a line allow a wave of its length
    assert "k = " in d["u_note"]
    assert "ISO 5436-1" in d["definition"]
    code, out, err = metrosep("geometry", "step_height", file, *words[:-1], "middle=0 mm")
    assert (code, out) == (4, "")
    assert "the data reach from 0" in err
    code, out, err = metrosep("geometry", "step_height", file, *words[:-2])
    assert (code, out) == (2, "")
    assert 'needs the key "middle"' in err


def test_a_groove_of_a_wrong_depth_is_rejected_and_without_u_nothing_is_decided(
    metrosep, tmp_path
):
    file = groove_file(tmp_path / "g.csv")
    words = (
        "--x",
        "Pos [um]",
        "--z",
        "Hoehe [nm]",
        "--set",
        "width=100 um",
        "--set",
        "middle=0.4 mm",
    )
    words = ("geometry", "step_height", file, *words)
    assert metrosep(*words, "--upper", "0.98 um", "--U", "from fit")[0] == 1
    assert metrosep(*words, "--upper", "2 um")[0] == 3
    assert metrosep(*words, "--upper", "h=-0.9 um", "--U", "h=from fit")[0] == 0
    assert metrosep(*words, "--lower", "h=0.9 um", "--U", "h=from fit")[0] == 1  # no ridge


def ball(path, bump=0.0, piston=0.0):
    """A map of a sphere of 50 mm, 8 mm wide, with one bump near (+2, -1) mm; written as points of text."""
    x = (np.arange(81) - 40) * 0.1e-3
    X, Y = np.meshgrid(x, x)
    z = 50e-3 - np.sqrt(50e-3**2 - X**2 - Y**2) + piston
    z += bump * np.exp(-((X - 2e-3) ** 2 + (Y + 1e-3) ** 2) / (0.3e-3) ** 2)
    z[X**2 + Y**2 > 4e-3**2] = np.nan
    ms.write(ms.Surface(z, 1e-4, 1e-4, origin=(x[0], x[0])), path)
    return path


@pytest.mark.parametrize(
    ("bump", "piston", "t"),
    [(1e-6, 0.0, 2.0), (-1e-6, 0.0, 2.0), (1e-6, 5e-7, 3.0), (-1e-6, 5e-7, 1.0)],
)
def test_profile_of_a_surface_where_it_lies(metrosep, tmp_path, bump, piston, t):
    """With the piston of +0.5 um a bump is 1.5 um off, a dent 0.5 um; t is twice that."""
    file = ball(tmp_path / "b.h5", bump, piston)
    words = ("--set", "form=sphere: R=50 mm", "--set")
    _, found = values(metrosep, "geometry", "surface_profile", file, *words, "datum=frame")
    assert abs(found["t"]["value"] - t * UM) < 5e-3 * UM  # normal distance: cos of 2.6 deg
    _, free = values(metrosep, "geometry", "surface_profile", file, *words, "datum=none")
    assert 0.9 * UM < free["t"]["value"] < 1.01 * UM  # half up, half down; the tilts take a little

    code, out, err = metrosep(
        "geometry", "surface_profile", file, "--set", "form=sphere", "--upper", "1 um"
    )
    assert (code, out) == (2, "")
    assert "R is not given" in err


def test_profile_of_a_line(metrosep, tmp_path):
    x = np.linspace(-4, 4, 401)
    z = 1e3 * (50 - np.sqrt(2500 - x**2))  # um
    z[300] += 0.8
    file = semicolons(tmp_path / "l.csv", list(zip(x, z, strict=True)), ("x [mm]", "z [um]"))
    words = ("--x", "x [mm]", "--z", "z [um]", "--set", "form=sphere: R=50 mm")
    code, found = values(
        metrosep, "geometry", "line_profile", file, *words, "--set", "datum=frame",
        "--set", "u_reading=10 nm", "--upper", "2 um",
    )  # fmt: skip
    assert code == 0
    assert abs(found["t"]["value"] - 1.6 * UM) < 5e-3 * UM
    assert found["t"]["u"] == pytest.approx(20e-9, rel=1e-9, abs=0.0)
    code, out, err = metrosep("geometry", "surface_profile", file, *words)
    assert (code, out) == (2, "")
    assert "take line_profile" in err


def test_a_cylinder_along_a_profile_is_not_taken_for_its_arc(metrosep, tmp_path):
    x = np.linspace(-6, 6, 61)
    z = 20 - np.sqrt(400 - x**2) + 0.0005 * np.cos(np.pi * x / 6)
    file = semicolons(tmp_path / "l.csv", np.stack([x, z], 1), ("x_mm", "z_mm"))
    words = ("geometry", "line_profile", file, "--set", "datum=frame", "--set")

    code, _, err = metrosep(*words, "form=cylinder: R=20 mm")
    assert code == 2
    assert "angle=90 deg" in err

    _, found = values(metrosep, *words, "form=cylinder: R=20 mm, angle=90 deg")
    assert abs(found["t"]["value"] - 1.0 * UM) < 2 * CLOSE  # the rim is steep: cos of 17 degrees


def test_the_example_is_made_by_its_script(repository, tmp_path):
    folder = repository / "examples" / "roundness_traces"
    spec = importlib.util.spec_from_file_location("make_data", folder / "make_data.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.main(tmp_path)
    assert (tmp_path / "traces.csv").read_bytes() == (folder / "traces.csv").read_bytes()


@pytest.mark.parametrize("lean", [1e-4, -1e-4])
def test_axial_run_out_of_a_shoulder(metrosep, tmp_path, lean):
    """A shoulder that is square to the table, about a shaft that leans in x: 2 r lean on each circle."""
    shaft = np.concatenate([circle(h, (lean * h, 0.0), 10.0) for h in (0, 10, 20)])
    rings = {"r15": circle(30, radius=15.0), "r20": circle(30.001, radius=20.0)}
    rows = [("A", p[2], p[0], p[1], f"a{p[2]:g}") for p in shaft]
    rows += [("S", p[2], p[0], p[1], ring) for ring, points in rings.items() for p in points]
    header = ("Element", "Z [mm]", "X [mm]", "Y [mm]", "Kreis")
    file = semicolons(tmp_path / "s.csv", rows, header)
    words = (*XYZ, "--section", "Kreis", "--set", "datum=A", "--set", "measured=axial")
    _, found = values(metrosep, "geometry", "run_out", file, *words)
    assert abs(found["CRO"]["value"] - 40e-3 * abs(lean)) < CLOSE
    # the outer circle is 1 um higher: from 2 um above it to 1.5 um below the inner one
    assert abs(found["TRO"]["value"] - 4.5 * UM) < CLOSE
    assert "axial" in found["TRO"]["definition"]
