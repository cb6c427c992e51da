"""Examples of the feed planner and of the XY plane: reproducible data, scores against truth."""

import importlib.util
import runpy

import numpy as np
import pytest

FILES = {"feedrate_plan": ("density.csv", "truth.csv"), "xy_plane": ("plane.csv", "truth.csv")}


@pytest.mark.parametrize("name", FILES)
def test_data_are_made_by_their_script(repository, tmp_path, name):
    folder = repository / "examples" / name
    spec = importlib.util.spec_from_file_location(f"make_{name}", folder / "make_data.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.main(tmp_path)

    for file in FILES[name]:
        assert (tmp_path / file).read_bytes() == (folder / file).read_bytes()


@pytest.mark.slow
def test_plan_keeps_its_promise_with_the_true_disturbance(repository, capsys):
    runpy.run_path(str(repository / "examples" / "feedrate_plan" / "plan.py"), run_name="__main__")
    out = capsys.readouterr().out

    assert "12.0 Hz disturbance maps onto 10.0 mm at 7200 mm/min; add a run at" in out
    rows = [r for r in out.splitlines() if "with the true disturbance" in r]
    old, planned, true = (
        [float(r.split(word)[1].split()[0]) for r in rows]
        for word in ("all at 7200", "plan", "true disturbance")
    )
    assert len(rows) == 5
    assert old[1] > 5 * planned[1]
    # 99 half-overlapping segments: a density is known to about 12 %, a sum over feeds better
    assert planned == pytest.approx(true, rel=0.15, abs=0.0)


def test_axes_of_the_plane_are_found_and_the_twist_is_named(repository, capsys):
    runpy.run_path(str(repository / "examples" / "xy_plane" / "fit_plane.py"), run_name="__main__")
    out = capsys.readouterr().out

    # 15 nm noise, 3 maps of 15 or 16 lines: 2.2 nm
    for axis in "xy":
        assert float(out.split(f"{axis}: RMS against truth")[1].split("nm")[0]) < 4.0
    found = float(out.split("coupled by")[1].split("nm")[0])
    twist = 40.0 * np.sqrt(17 / 45 * 16 / 42)  # RMS over 16 x 15 points
    assert found == pytest.approx(twist, rel=0.1, abs=0.0)
    before = float(out.split("plane P-V")[1].split("um")[0])
    after = float(out.split("after the correction")[1].split("um")[0])
    flipped = float(out.split("flipped it would be")[1].split("um")[0])
    assert after < 0.2 * before
    assert flipped > 1.8 * before
