"""Repeated runs as loggers in eight languages write them: `check` finds them, its call separates them.

The files are made here from four runs of known numbers; each reading is compared, and the call that `check`
prints is run as it stands.
"""

import shlex

import numpy as np
import pytest

import metrosep as ms

X = np.round(0.5 * np.arange(40), 3)
RNG = np.random.default_rng(3)
RUNS = [np.round(2.0 * np.sin(X / 3.0) + RNG.normal(0.0, 0.05, 40), 3) for _ in range(4)]
SAME = 1e-15
"""Metres: the digits of the file, times a factor."""


def table(head, row, *, comma=False, back=False, above=None, below=""):
    """Return the text of four runs; `row` gets k, i, x, z and d, the sign of the direction."""
    text = head
    for k, run in enumerate(RUNS):
        text += "" if above is None else above.format(k=k + 1)
        pairs = list(zip(X.tolist(), run.tolist(), strict=True))
        d = -1 if back and k % 2 else 1
        for i, (x, z) in enumerate(pairs[::d]):
            line = row(k + 1, i, x, z, d)
            text += (line.replace(".", ",") if comma else line) + "\n"
    return text + below


def plain(k, i, x, z, d):
    return f"{k},{x},{z}"


def semicolons(k, i, x, z, d):
    return f"{k};{x};{z}"


FILES = {
    "french": (
        table(
            "Passe;Abscisse (mm);Écart (µm);Avance (mm/min)\n",
            lambda k, i, x, z, d: f"{k};{x};{z};{1000 * (1 + k % 2)}",
            comma=True,
        ),
        "cp1252",
    ),
    "chinese": (table("次数,位置(mm),偏差(μm)\n", plain), "gb18030"),
    "japanese": (
        table(
            "回数,方向,位置(mm),誤差(μm)\n",
            lambda k, i, x, z, d: f"{k},{'正' if d > 0 else '逆'},{x},{z}",
            back=True,
        ),
        "cp932",
    ),
    "russian": (
        table("Проход;Координата, мм;Отклонение, мкм\n", semicolons, comma=True),
        "cp1251",
    ),
    "blocks": (
        table("Position[mm]\tError[um]\n", lambda k, i, x, z, d: f"{x}\t{z}", above="\n"),
        "utf-8",
    ),
    "heads": (
        table("", lambda k, i, x, z, d: f"{x}\t{z}", above="Position[mm]\tError[um]\n"),
        "utf-16",
    ),
    "titles": (
        table("x_mm z_um\n", lambda k, i, x, z, d: f"{x} {z}", above="# Run {k} of 4\n"),
        "utf-8",
    ),
    "remark": (
        table(
            "Run,Pos [mm],Err [um],Remark\n",
            lambda k, i, x, z, d: f"R{k},{x},{z},{'door' if (k, i) == (3, 6) else ''}",
        ),
        "utf-8",
    ),
    "beside": (
        table(
            "run,x_mm,z_um\n",
            lambda k, i, x, z, d: f"{k},{x},{z}{',door open' if (k, i) == (3, 6) else ''}",
        ),
        "utf-8",
    ),
    "missing": (
        table(
            "run;x_mm;z_um\n",
            lambda k, i, x, z, d: f"{k};{x};{'***' if (k, i) == (2, 10) else z}",
        ),
        "utf-8-sig",
    ),
    "statistics": (table("run;x_mm;z_um\n", semicolons, below="\nMean;;0.1\nSD;;1.3\n"), "utf-8"),
    "signs": (
        table(
            "run,x_mm,z_um\n",
            lambda k, i, x, z, d: f"{k}{'+' if d > 0 else '-'},{x},{z}",
            back=True,
        ),
        "utf-8",
    ),
    "clock": (
        table(
            "Lauf;Zeit;Weg [mm];Taster [µm]\n",
            lambda k, i, x, z, d: f"{k};14:{k:02d}:{i:02d}.{5 * (i % 2)};{x};{z}",
            comma=True,
        ),
        "cp1252",
    ),
}


@pytest.mark.parametrize("name", FILES)
def test_the_call_of_check_separates_every_run_and_no_number_changes(name, tmp_path, metrosep):
    text, encoding = FILES[name]
    path = tmp_path / f"{name}.csv"
    path.write_bytes(text.encode(encoding))

    code, out, _ = metrosep("check", path)

    assert code == 0, out
    assert "holds 4 runs" in out
    call = next(line for line in out.splitlines() if "metrosep separate" in line)
    words = shlex.split(call.partition("metrosep separate ")[2])
    code, _, err = metrosep("separate", *words, "--method", "mean", "-o", tmp_path / "out")
    assert code in (0, 1, 3), err  # separated, whatever the verdict on the table
    options = dict(zip(words[1::2], words[2::2], strict=True))
    runs = ms.read_runs(path, **{k.lstrip("-").replace("-", "_"): v for k, v in options.items()})
    assert len(runs) == len(RUNS)
    for found, run in zip(runs, RUNS, strict=True):
        order = 1 if found.x[0] < found.x[-1] else -1
        assert np.abs(found.x[::order] - X * 1e-3).max() < SAME
        off = np.abs(found.z[::order] - run * 1e-6)
        assert np.nanmax(off) < SAME
        assert np.isnan(off).sum() == (name == "missing" and found.run_id == "2")
    if options["--run"] != "blocks":
        assert isinstance(ms.read(path), ms.RunSet)
