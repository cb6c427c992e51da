"""One door: `separate` with the name of a method makes what the function and the recipe make."""

import pickle
import tomllib
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import DataError, InvalidSamplesError, OptionError, UnitError
from metrosep.core.methods import METHODS
from metrosep.recipe.method_run import load_inputs
from metrosep.separation import (
    ball_average,
    closure,
    donaldson,
    face_reversal,
    iso230_2,
    iso230_7,
    multiprobe,
    multistep,
    orthogonal_mixed,
    separate,
    straightedge_reversal,
    three_point,
    zero_calibration,
)

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
RNG = np.random.default_rng(22)
ANGLE = 2.0 * np.pi * np.arange(128) / 128
X = np.linspace(0.0, 0.3, 31)


def recipes():
    """Give the recipes of the examples whose one step is a method."""
    for file in sorted(EXAMPLES.glob("*/*.toml")):
        recipe = tomllib.loads(file.read_text("utf-8"))
        steps = recipe.get("step")
        if isinstance(steps, list) and len(steps) == 1 and steps[0].get("op") in METHODS:
            yield pytest.param(file, id=f"{steps[0]['op']} {file.parent.name}/{file.name}")


def equal(found, wanted):
    """Whether results hold the same numbers."""
    assert type(found) is type(wanted)
    for name in wanted.parts:
        np.testing.assert_array_equal(found.parts[name], wanted.parts[name])
        np.testing.assert_array_equal(found.u[name], wanted.u[name])
    assert dict(found.audit) == dict(wanted.audit)
    assert found.messages == wanted.messages


def plain(value, folder):
    """Return an option with tuples for lists and files by their whole name."""
    if isinstance(value, dict):
        return {k: plain(v, folder) for k, v in value.items() if v is not None}
    if isinstance(value, list | tuple):
        return tuple(plain(v, folder) for v in value)
    if isinstance(value, str | Path) and (folder / value).is_file():
        return str(folder / value)
    return value


class ReachedError(Exception):
    """What came to the method: its data and its options."""


@pytest.mark.parametrize("file", [*recipes()])
def test_the_options_of_a_recipe_do_the_same_in_python(file, monkeypatch):
    """The method gets the same from both doors; what it makes of that is for its own tests."""
    monkeypatch.chdir(file.parent)
    step = dict(tomllib.loads(file.read_text("utf-8"))["step"][0])
    method = METHODS[step.pop("op")]
    recipe = ms.Recipe.load(file)
    files = [f for name in recipe.input.get("files", ()) for f in sorted(file.parent.glob(name))]
    reading = {k: v for k, v in recipe.input.items() if k != "files"}
    data = None if method.reads == "nothing" else load_inputs(method, files, reading)

    def reached(data, options):
        raise ReachedError(pickle.dumps(data), plain(dict(options), file.parent))

    monkeypatch.setattr(method, "from_inputs", reached)
    with pytest.raises(ReachedError) as wanted:
        recipe.run()
    if "method" in step:
        step["method_"] = step.pop("method")
    with pytest.raises(ReachedError) as found:
        separate(data, method=method.name, **step)

    assert found.value.args == wanted.value.args


def readings(*shape):
    return RNG.normal(0.0, 1e-8, shape)


M2, M3, M4, M8, Z3 = readings(2, 3, 128), readings(3, 128), readings(4, 128), readings(8, 128), readings(3, 31)  # fmt: skip
PROBES = ("0 deg", "45 deg", "135 deg")


@pytest.mark.parametrize(
    ("found", "wanted"),
    [
        (
            lambda: separate(M2, method="donaldson", angle=ANGLE, u_index="0.1 deg"),
            lambda: donaldson(*M2, angle=ANGLE, u_index=np.deg2rad(0.1)),
        ),
        (
            lambda: separate({"m2": M2[1], "m1": M2[0], "angle": ANGLE}, method="donaldson"),
            lambda: donaldson(*M2, angle=ANGLE),
        ),
        (
            lambda: separate([ms.Profile(ANGLE, m[0]) for m in M2], method="donaldson"),
            lambda: donaldson(*(ms.Profile(ANGLE, m[0]) for m in M2)),
        ),
        (
            lambda: separate(M4, method="face_reversal", radius="25 mm"),
            lambda: face_reversal(*M4[:3], 25e-3, axial2=M4[3]),
        ),
        (
            lambda: separate(M3, method="multiprobe", angles=PROBES, kmax=20, u_reading="1 nm"),
            lambda: multiprobe(M3, np.deg2rad([0, 45, 135]), 20, u_reading=1e-9),
        ),
        (lambda: separate(M8, method="multistep", steps=8), lambda: multistep(M8, steps=8)),
        (
            lambda: separate(
                M3[:1], method="orthogonal_mixed", slope=1e-1 * M3[1], kmax=9, radius="10 mm"
            ),
            lambda: orthogonal_mixed(M3[0], 1e-1 * M3[1], 9, radius=10e-3),
        ),
        (
            lambda: separate(
                1e2 * M8[:, :12], method="closure", positions=range(8), u_reading="1 urad"
            ),
            lambda: closure(1e2 * M8[:, :12], positions=range(8), u_reading=1e-6),
        ),
        (
            lambda: separate(Z3[:2], method="straightedge_reversal", x=X),
            lambda: straightedge_reversal(*Z3[:2], x=X),
        ),
        (
            lambda: separate(Z3, method="three_point", x=X, distance="10 mm", u_reading="1 nm"),
            lambda: three_point(Z3, 10e-3, x=X, u_reading=1e-9),
        ),
    ],
    ids=range(10),
)
def test_arrays_profiles_and_columns_give_what_the_function_gives(found, wanted):
    equal(found(), wanted())


def test_results_of_their_own_kind():
    assert (
        separate(Z3, method="zero_calibration", distance="10 mm", x=X, step="10 mm").zero
        == zero_calibration(Z3, 10e-3, flat=0.0, step=10e-3).zero
    )
    rows = RNG.normal(0.0, 1e-7, (8, 16))
    turn = 2.0 * np.pi * np.arange(16) / 16
    by_name = separate([rows], method="iso230_7", angle=turn)
    assert by_name.to_dict() == iso230_7(rows, turn).to_dict()
    target = np.arange(5) * 0.1
    forward, backward = (target[:, None] + RNG.normal(0, 1e-6, (5, 5)) for _ in range(2))
    columns = {"target": target, "forward": forward, "backward": backward}
    wanted = iso230_2(target, forward, backward)
    assert separate(columns, method="iso230_2").to_dict() == wanted.to_dict()


def test_maps():
    maps = [ms.Surface(RNG.normal(0, 1e-9, (24, 24)), 1e-4, 1e-4) for _ in range(5)]
    equal(separate(maps, method="ball_average"), ball_average(maps))


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({"method": "donaldsen"}, DataError, 'Did you mean "donaldson"'),
        ({"method": "donaldson", "u_indx": 1e-3}, OptionError, 'Did you mean "u_index"'),
        ({"method": "donaldson", "u_index": "1 mm"}, UnitError, "u_index = '1 mm'.*angle"),
        ({"method": "face_reversal"}, OptionError, "needs the option 'radius'"),
        ({"method": "donaldson", "lag": 1e-3}, OptionError, "no option 'lag'"),
        ({"method": "multistep", "drift": "square"}, OptionError, "none, linear"),
        ({"method": "face_reversal", "radius": "25 mm"}, InvalidSamplesError, "3 readings"),
        ({"method": "speed_dependence"}, DataError, "columns by their role"),
    ],
)
def test_refusals(options, error, match):
    with pytest.raises(error, match=match):
        separate(M2, **options)
