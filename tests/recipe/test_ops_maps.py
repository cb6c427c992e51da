"""Maps and planes from recipes: the same maps as the call gives, in files, charts and checks."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import MetrosepError, RecipeError
from metrosep.recipe.result import load_document
from metrosep.separation import (
    ball_average,
    coupled_grid,
    fit_plane_model,
    grid_calibration,
    repeatable,
    rotation_average,
    stitch,
    three_flat,
    three_positions,
)
from metrosep.separation.maps.lateral_shifts import shift_rotation

N, DX = 41, 1e-3
LINE = np.linspace(-1.0, 1.0, N)
ROW, COLUMN = LINE, LINE[:, None]
A = 30e-9 * (ROW**3 * COLUMN + ROW**2) + 10e-9 * COLUMN**3
B = 12e-9 * (ROW**3 - ROW * COLUMN) + 4e-9 * COLUMN**2
C = 9e-9 * (ROW * COLUMN**2) - 6e-9 * ROW**2
TEXT = 1e-15
"""Maps are stored as doubles; sums of them round."""


@pytest.fixture
def maps(tmp_path):
    def write(*arrays):
        files = []
        for i, z in enumerate(arrays):
            files.append(tmp_path / f"map{i}.h5")
            ms.write(ms.Surface(z, DX, DX), files[-1])
        return files

    return write


def noise(seed):
    return 0.2e-9 * np.random.default_rng(seed).standard_normal((N, N))


def run(op, files, step="", rest="", **options):
    text = f'metrosep = 1\n[input]\n{rest}[[step]]\nop = "{op}"\n{step}'
    return ms.Recipe.parse(text).run(files, **options)


def same(found, called):
    assert set(found.parts) == set(called.parts)
    for part in called.parts:
        np.testing.assert_allclose(found.parts[part], called.parts[part], rtol=0.0, atol=TEXT)
        np.testing.assert_allclose(found.u[part], called.u[part], rtol=1e-6, atol=TEXT)


QUARTERS = '["0 deg", "90 deg", "180 deg", "270 deg"]'


def test_rotations_with_files_charts_and_a_verdict(maps, tmp_path):
    turned = [np.rot90(A, -k) + B + noise(k) for k in range(4)]
    step = f"angles = {QUARTERS}\n" + '[[check]]\nmetric = "instrument.pv"\nupper = "60 nm"\n'
    step += '[[output]]\nkind = "parts"\n[[output]]\nkind = "report"\n'
    result = run("rotation_average", maps(*turned), step, out=tmp_path / "out")

    called = rotation_average(turned, np.radians([0, 90, 180, 270]), dx=DX, dy=DX)
    same(result.produced, called)
    assert result.verdict == "accept"
    names = [f.name for f in result.files]
    assert names[:3] == ["parts-part.h5", "parts-instrument.h5", "parts-unseparated.h5"]
    stored = ms.read(tmp_path / "out" / "parts-instrument.h5")
    np.testing.assert_array_equal(stored.z, result.produced.instrument)
    chart = load_document(tmp_path / "out")["separation"]["charts"][0]
    assert chart["kind"] == "maps"
    drawn = np.array(chart["parts"]["instrument"], dtype=float)
    np.testing.assert_allclose(drawn, called.instrument, rtol=1e-3, atol=1e-12)
    assert "Maps of the parts" in (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "not_stored" not in load_document(tmp_path / "out")["separation"]


def test_large_maps_are_thinned_in_the_document(tmp_path):
    n = 400
    line = np.linspace(-1, 1, n)
    part = 30e-9 * (line**3 * line[:, None] + line**2)
    files = []
    for k in range(4):
        files.append(tmp_path / f"m{k}.h5")
        ms.write(ms.Surface(np.rot90(part, -k) + 1e-9 * line[:, None], DX, DX), files[-1])
    run(
        "rotation_average",
        files,
        f"angles = {QUARTERS}\n" + '[[output]]\nkind = "parts"\n',
        out=tmp_path / "out",
    )
    separation = load_document(tmp_path / "out")["separation"]
    assert (tmp_path / "out" / "result.json").stat().st_size < 3_000_000
    assert separation["parts"] == {}
    assert "480000 values" in separation["not_stored"]
    chart = separation["charts"][0]
    assert max(np.array(chart["parts"]["part"], dtype=float).shape) <= 256
    assert "Drawn at 1/3 of the resolution" in chart["caption"]
    assert chart["dx_m"] == pytest.approx(3 * DX, abs=1e-12)


def test_three_flats_with_one_turned(maps):
    ab, ac, bc = A + B[:, ::-1], A + C[:, ::-1], B + C[:, ::-1]
    turned = np.rot90(A, -1) + B[:, ::-1]
    step = 'angles = ["90 deg"]\nu_reading = "0.2 nm"\n'
    found = run("three_flat", maps(ab, ac, bc, turned), step).produced
    same(found, three_flat(ab, ac, bc, [turned], [np.pi / 2], dx=DX, dy=DX, u_reading=0.2e-9))
    with pytest.raises(MetrosepError, match=r"1 file\(s\) follow AB, AC, BC, but angles has 0"):
        run("three_flat", maps(ab, ac, bc, turned), 'u_reading = "0.2 nm"\n')
    with pytest.raises(MetrosepError, match="3 readings are needed"):
        run("three_flat", maps(ab, ac))


def test_files_keep_the_order_of_the_recipe(tmp_path):
    pieces = {
        "z.h5": A + B[:, ::-1],
        "m.h5": A + C[:, ::-1],
        "a.h5": B + C[:, ::-1],
        "b.h5": np.rot90(A, -1) + B[:, ::-1],
    }
    for name, z in pieces.items():
        ms.write(ms.Surface(z, DX, DX), tmp_path / name)
    step = 'angles = ["90 deg"]\nu_reading = "0.2 nm"\n'
    rest = 'files = ["z.h5", "m.h5", "a.h5", "b.h5"]\n'
    result = run("three_flat", tmp_path, step, rest)
    ab, ac, bc, turned = pieces.values()
    same(
        result.produced,
        three_flat(ab, ac, bc, [turned], [np.pi / 2], dx=DX, dy=DX, u_reading=0.2e-9),
    )
    assert [i["name"] for i in result.document["inputs"]] == list(pieces)
    with pytest.raises(MetrosepError, match=r"no file matches q\.h5"):
        run("three_flat", tmp_path, step, rest.replace("m.h5", "q.h5"))


def test_files_of_a_pattern_are_in_the_order_of_their_numbers(tmp_path):
    for degrees in (0, 90, 180, 270):
        z = np.rot90(A, -degrees // 90) + B
        ms.write(ms.Surface(z, DX, DX), tmp_path / f"turn{degrees}.h5")
    result = run("rotation_average", tmp_path, f"angles = {QUARTERS}\n", 'files = ["turn*.h5"]\n')
    assert [i["name"] for i in result.document["inputs"]] == [
        f"turn{d}.h5" for d in (0, 90, 180, 270)
    ]


def test_three_flats_without_a_turn_name_diameters_and_shares(maps):
    ab, ac, bc = A + B[:, ::-1], A + C[:, ::-1], B + C[:, ::-1]
    result = run("three_flat", maps(ab, ac, bc), 'u_reading = "0.2 nm"\n')
    called = three_flat(ab, ac, bc, dx=DX, dy=DX, u_reading=0.2e-9)
    same(result.produced, called)
    assert any(c["metric"].startswith("diameter_A") for c in result.document["characteristics"])


def test_balls_and_three_positions(maps):
    patches = [B + noise(i) for i in range(6)]
    same(run("ball_average", maps(*patches)).produced, ball_average(patches, dx=DX, dy=DX))
    three = (A + B, A[::-1, ::-1] + B, B)
    found = run("three_positions", maps(*three), 'u_reading = "0.2 nm"\n').produced
    same(found, three_positions(*three, dx=DX, dy=DX, u_reading=0.2e-9))


def test_stitching_at_positions(maps):
    pieces = [A[:, :25] + noise(1)[:, :25], A[:, 16:] + noise(2)[:, 16:] + 3e-9 * LINE[16:]]
    files = maps(*pieces)
    step = 'positions = [["0 mm", "0 mm"], ["16 mm", "0 mm"]]\n'
    found = run("stitch", files, step).produced
    same(found, stitch(pieces, [[0, 0], [16e-3, 0]], dx=DX, dy=DX))
    known = run(
        "stitch", maps(0 * pieces[0] + 1e-9, *pieces), step + 'reference = "first"\n'
    ).produced
    np.testing.assert_allclose(np.ptp(known.surface), np.ptp(found.surface), rtol=0.2)
    with pytest.raises(RecipeError, match="x and y"):
        run("stitch", files, 'positions = [["0 mm"], ["16 mm", "0 mm"]]\n')


def test_shifts_and_turns(maps):
    x, y = np.meshgrid(LINE, LINE)
    inside = np.hypot(x, y) < 0.98

    def part(u, v):
        return 20e-9 * (u**3 - 3 * u * v**2) + 9e-9 * u * v

    def instrument(u, v):
        return 7e-9 * (v**3 - 3 * v * u**2) + 5e-9 * (u**2 - v**2)

    surfaces = []
    for turn, shift in ((0, 0.0), (90, 0.0), (180, 0.0), (0, 0.15)):
        c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        u, v = c * (x - shift) + s * y, -s * (x - shift) + c * y
        z = part(u, v) + instrument(x, y) + noise(turn)
        surfaces.append(np.where(inside, z, np.nan))
    step = (
        'angles = ["0 deg", "90 deg", "180 deg", "0 deg"]\n'
        'shifts = [["0 mm", "0 mm"], ["0 mm", "0 mm"], ["0 mm", "0 mm"], ["3 mm", "0 mm"]]\n'
        'terms = 15\nu_reading = "0.2 nm"\n'
    )
    result = run("shift_rotation", maps(*surfaces), step)
    called = shift_rotation(
        surfaces,
        np.radians([0, 90, 180, 0]),
        [[0, 0], [0, 0], [0, 0], [3e-3, 0]],
        terms=15,
        dx=DX,
        dy=DX,
        u_reading=0.2e-9,
    )
    np.testing.assert_allclose(result.produced.part, called.part, rtol=0.0, atol=TEXT)
    np.testing.assert_allclose(
        result.produced.zernike_part, called.zernike_part, rtol=0.0, atol=TEXT
    )


def test_repeats_and_registration(maps):
    several = [A + noise(i) for i in range(3)]
    found = run("repeatable_maps", maps(*several)).produced
    called = repeatable([ms.Surface(z, DX, DX) for z in several])
    np.testing.assert_allclose(found.repeatable, called.repeatable, rtol=0.0, atol=TEXT)

    hills = 50e-9 * np.sin(4 * ROW) + 40e-9 * ROW * COLUMN**2
    moved = 50e-9 * np.sin(4 * (ROW - 0.05)) + 40e-9 * (ROW - 0.05) * COLUMN**2
    result = run("register_maps", maps(hills, moved), "rotation = false\n")
    values = {c["metric"]: c["value"] for c in result.document["characteristics"]}
    assert values["shift_x"] == pytest.approx(1e-3, abs=2e-5)  # 0.05 of half the width of 40 mm
    assert values["shift_y"] == pytest.approx(0.0, abs=2e-5)


def test_maps_are_needed_where_maps_are_asked_for(tmp_path):
    ms.write(ms.Profile(np.arange(50) * 1e-3, np.zeros(50)), tmp_path / "p.csv")
    with pytest.raises(MetrosepError, match="needs maps of heights"):
        run("ball_average", [tmp_path / "p.csv"])


X, Y = np.arange(8) * 2e-3, np.arange(6) * 3e-3


def plane_table(path, layers, head):
    """Rows of all layers: a layer is (labels, dict of arrays (n_y, n_x)), NaN left out."""
    lines = [head]
    for labels, values in layers:
        for i, y in enumerate(Y):
            for j, x in enumerate(X):
                cells = [v[i, j] for v in values]
                if not np.isnan(cells).any():
                    numbers = [
                        f"{x * 1e3:.6f}",
                        f"{y * 1e3:.6f}",
                        *(f"{c * 1e9:.9f}" for c in cells),
                    ]
                    lines.append(",".join([*labels, *numbers]))
    path.write_text("\n".join(lines) + "\n", "ascii")
    return path


PLACE = 'x = "x_mm"\ny = "y_mm"\n'


def test_plane_from_a_table_of_points(tmp_path):
    rng = np.random.default_rng(3)
    one = 1e-6 * np.sin(300 * X) + 1e-6 * np.cos(200 * Y)[:, None] + 2e-6 * X
    stack = one + 5e-9 * rng.standard_normal((3, Y.size, X.size))
    stack[0, 2, 3] = np.nan
    file = plane_table(
        tmp_path / "p.csv", [((str(r),), (m,)) for r, m in enumerate(stack)], "rep,x_mm,y_mm,z_nm"
    )
    rest = PLACE + 'z = "z_nm"\nrepeat = "rep"\n'
    result = run("fit_plane_model", file, rest=rest)
    called = fit_plane_model(stack, dx=2e-3, dy=3e-3)
    np.testing.assert_allclose(result.produced.along_x.z, called.along_x.z, rtol=0.0, atol=1e-14)
    found = {c["metric"]: c["value"] for c in result.document["characteristics"]}
    assert found["along_y.pv"] == pytest.approx(float(np.ptp(called.along_y.z)), abs=1e-14)
    assert found["beta"] == pytest.approx(called.beta.value, abs=1e-10)
    with pytest.raises(MetrosepError, match="occurs twice"):
        run("fit_plane_model", file, rest=rest.replace('repeat = "rep"\n', ""))


def test_uneven_grids_are_refused(tmp_path):
    file = tmp_path / "p.csv"
    rows = [f"{x},{y},1.0" for x in (0.0, 1.0, 2.4) for y in (0.0, 1.0)]
    file.write_text("x_mm,y_mm,z_nm\n" + "\n".join(rows) + "\n", "ascii")
    with pytest.raises(MetrosepError, match="equal steps"):
        run("fit_plane_model", file, rest=PLACE + 'z = "z_nm"\n')


def test_lines_in_both_directions_from_a_table(tmp_path):
    z = 1e-6 * np.sin(300 * X) * np.cos(200 * Y)[:, None] + 4e-7 * X
    rng = np.random.default_rng(8)
    along = [z + 2e-9 * rng.standard_normal(z.shape) for _ in range(2)]
    file = plane_table(
        tmp_path / "p.csv",
        [((w,), (m,)) for w, m in zip("xy", along, strict=True)],
        "line,x_mm,y_mm,z_nm",
    )
    rest = PLACE + 'z = "z_nm"\nline = "line"\n'
    found = run("coupled_grid", file, rest=rest, step='slopes = "common"\n').produced
    called = coupled_grid(*along, dx=2e-3, dy=3e-3, slopes="common")
    np.testing.assert_allclose(found.error, called.error, rtol=0.0, atol=1e-14)


def test_grid_plate_from_a_table_of_views(tmp_path):
    rng = np.random.default_rng(9)
    n, pitch = 5, 10e-3
    stage, plate = (1e-7 * rng.standard_normal((n, n, 2)) for _ in range(2))
    spun = np.rot90(plate, -1)
    turned = np.stack([-spun[..., 1], spun[..., 0]], axis=-1)
    shifted = np.full_like(plate, np.nan)
    shifted[:, 1:] = plate[:, :-1]
    views = {"initial": stage + plate, "rotated": stage + turned, "shifted": stage + shifted}
    lines = ["view,x_mm,y_mm,ex_nm,ey_nm"]
    for name, v in views.items():
        for i in range(n):
            for j in range(n):
                if not np.isnan(v[i, j]).any():
                    ex, ey = v[i, j] * 1e9
                    lines.append(f"{name},{j * 10},{i * 10},{ex:.9f},{ey:.9f}")
    file = tmp_path / "g.csv"
    file.write_text("\n".join(lines) + "\n", "ascii")
    rest = PLACE + 'ex = "ex_nm"\ney = "ey_nm"\nview = "view"\n'
    result = run("grid_calibration", file, rest=rest)
    called = grid_calibration(views, pitch=pitch)
    np.testing.assert_allclose(result.produced.stage, called.stage, rtol=0.0, atol=1e-14)
    assert set(result.document["separation"]["charts"][0]["parts"]) == {
        "stage_x", "stage_y", "plate_x", "plate_y"
    }  # fmt: skip
    own = run(
        "grid_calibration",
        file,
        rest=rest,
        step="turns = [0, 1, 0]\nshifts = [[0, 0], [0, 0], [1, 0]]\n",
    ).produced
    np.testing.assert_allclose(own.stage, called.stage, rtol=0.0, atol=1e-14)
