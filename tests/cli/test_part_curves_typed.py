"""Curves of a lathe from two parts by the command line: the parts are drawn by machines.md, eq. 20, as text.

Both carry an asymmetry: a mirrored spindle or a swapped slide gives other numbers.
"""

import csv
import tomllib

import numpy as np
import pytest

NM = 1e-9
R = 20e-3


def ezx(rho):
    return 40 * NM * np.cos(2 * np.pi * rho / 16e-3)


def ezc(theta):
    return 25 * NM * np.cos(2 * theta + 0.4)


def exc(theta):
    return 30 * NM * np.sin(3 * theta)


def drawn(path, radius, rng, n=48):
    """A part as its map is logged: decimal commas, places without a height, tilted as it lay."""
    at = (np.arange(n) - (n - 1) / 2) * (2.0 * R / n)
    x, y = np.meshgrid(at, at)
    rho, theta = np.hypot(x, y), -np.arctan2(y, x)
    z, slope = np.zeros_like(x), np.zeros_like(x)
    if radius is not None:
        root = np.sqrt(radius**2 - rho**2)
        z, slope = radius - root, rho / root
    z = z + ezx(rho) - ezc(theta) + slope * exc(theta) + NM * rng.normal(size=x.shape)
    z += 4e-6 * x - 3e-6 * y
    z[(rho > R) | (rho < 1e-3) | (rng.random(x.shape) < 0.01)] = np.nan
    rows = [
        f"{a:.5f};{b:.5f};{'' if np.isnan(c) else f'{c:.5f}'}".replace(".", ",")
        for a, b, c in zip(x.ravel() * 1e3, y.ravel() * 1e3, z.ravel() * 1e6, strict=True)
    ]
    path.write_text("\n".join(["x_mm;y_mm;z_um", *rows]) + "\n")


def columns_of(path):
    """Columns of a written file of terms."""
    lines = [
        row for row in csv.reader(path.read_text().splitlines()) if not row[0].startswith("#")
    ]
    return dict(zip(lines[0], np.array(lines[1:], dtype=float).T, strict=True))


def test_curves_are_typed_with_braces_too(metrosep, tmp_path, monkeypatch):
    """As TOML has them; the numbers are judged where the same curves are typed without."""
    monkeypatch.chdir(tmp_path)
    drawn(tmp_path / "face.csv", None, np.random.default_rng(11), n=24)
    code, _, err = metrosep(
        *("separate", "face.csv", "--method", "identify", "--set", "machine=sts_lathe"),
        *("--set", "radius=20 mm", "--set", "forms=plane", "--set", "curves={ EZX = 4, EZC = 3 }"),
        *("--set", "centre=0 mm,0 mm", "-o", "out"),
    )  # fmt: skip
    assert code == 0, err
    spindle = columns_of(tmp_path / "out" / "C.csv")
    # 24 pixels across and four orders along: a wave of 25 nm comes back with its sign
    assert spindle["EZC_um"] * 1e3 == pytest.approx(
        ezc(np.radians(spindle["c_deg"])) / NM, abs=3.0
    )


def test_curves_of_two_parts_are_typed_as_a_table(metrosep, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(11)
    drawn(tmp_path / "face.csv", None, rng)
    drawn(tmp_path / "hollow.csv", 60e-3, rng)
    code, _, err = metrosep(
        *("separate", "face.csv", "hollow.csv", "--method", "identify", "--set", "machine=sts_lathe"),
        *("--set", "radius=20 mm", "--set", "forms=plane,sphere: R=60 mm", "--set", "curves=EZX=6, EZC=3, EXC=4"),
        *("--set", "centre=0 mm,0 mm", "-o", "out"),
    )  # fmt: skip
    assert code == 0, err
    spindle, slide = columns_of(tmp_path / "out" / "C.csv"), columns_of(tmp_path / "out" / "X.csv")
    theta = np.radians(spindle["c_deg"])
    # the noise of a coefficient of EZC is 0.05 nm; EXC acts by the slope, 0.2 in the mean: 0.2 nm
    assert spindle["EZC_um"] * 1e3 == pytest.approx(ezc(theta) / NM, abs=0.5)
    assert spindle["EXC_um"] * 1e3 == pytest.approx(exc(theta) / NM, abs=2.0)
    found = slide["EZX_um"] * 1e3
    line = np.polyfit(slide["x_mm"], ezx(slide["x_mm"] * 1e-3) / NM - found, 1)
    # six orders leave 1 nm of a wave of 16 mm over 19 mm
    left = ezx(slide["x_mm"] * 1e-3) / NM - found - np.polyval(line, slide["x_mm"])
    assert np.sqrt(np.mean(left**2)) < 2.0


def test_what_is_no_table_is_refused_with_the_way_to_type_it(metrosep, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    drawn(tmp_path / "face.csv", None, np.random.default_rng(1), n=12)
    for typed in ("EZX", "{ EZX = auto }", "EZX="):
        code, _, err = metrosep(
            *("separate", "face.csv", "--method", "identify", "--set", "machine=sts_lathe"),
            *("--set", "radius=20 mm", "--set", f"curves={typed}"),
        )
        assert code == 2
        assert "--set curves" in err
        assert "NAME=VALUE" in err


@pytest.mark.parametrize(
    ("typed", "meant"),
    [("EZX=06,EZC=auto", {"EZX": 6, "EZC": "auto"}), ("EZX=٣", {"EZX": 3}), ('E"Z=3', {'E"Z': 3})],
)
def test_a_count_with_zeros_before_it_is_that_count(metrosep, typed, meant):
    words = (
        "separate",
        "--method",
        "identify",
        "--print-recipe",
        "part.h5",
        "--set",
        "threshold=02",
    )
    code, out, err = metrosep(*words, "--set", f"curves={typed}")
    assert code == 0, err
    (step,) = tomllib.loads(out)["step"]
    assert step["curves"] == meant
    assert step["threshold"] == 2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ("--set", "curves=EZX=3", "--set", "curves=EZX=4"),
            "--set curves is given twice: keep one",
        ),
        (("--set", "curves=EZX=3,EZX=4"), "--set curves EZX is given twice: keep one"),
        (
            ("--set", "machine-radius=1 m", "--set", "machine_radius=2 m"),
            "--set machine_radius is given twice",
        ),
        (("--column", "map=a", "--column", "map=b"), "--column map is given twice"),
    ],
)
def test_a_name_that_is_given_twice_is_refused(metrosep, words, said):
    code, out, err = metrosep(
        "separate", "--method", "identify", "--print-recipe", "part.h5", *words
    )
    assert (code, out) == (2, "")
    assert said in err
