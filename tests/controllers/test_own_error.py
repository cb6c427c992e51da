"""Writing without measured runs: the error that the table was made of is the dry-run."""

import json

import numpy as np
import pytest

from metrosep import Profile, controllers
from metrosep.compensation import CompensationTable
from metrosep.errors import SignCheckFailedError

X = np.linspace(0, 40e-3, 401)
ERROR = 1e-6 * np.sin(2 * np.pi * X / 25e-3) * (1 + X / 40e-3)


@pytest.fixture
def made():
    return CompensationTable.from_error(Profile(X, ERROR), positions="1 mm", axis="X")


def test_sidecar_says_what_it_was_verified_against(tmp_path, made):
    verification = controllers.write(made, tmp_path / "x.comp")
    sidecar = json.loads((tmp_path / "x.comp.json").read_text())

    assert verification.after_rms < 0.02 * verification.before_rms
    assert "no measured runs" in sidecar["verification"]["against"]


def test_flipped_table_is_refused_all_the_same(tmp_path, made):
    with pytest.raises(SignCheckFailedError, match="the reversed sign would shrink it"):
        controllers.write(made.negated(), tmp_path / "x.comp")
    assert list(tmp_path.iterdir()) == []


def test_each_direction_is_checked_against_its_own_error(tmp_path):
    table = CompensationTable.from_error(
        Profile(X, ERROR), reverse=Profile(X, -ERROR), positions="1 mm", axis="X"
    )
    verification = controllers.write(table, tmp_path / "x.comp")

    assert [r.direction for r in verification.residuals] == [1, -1]
    assert verification.passed


def test_table_without_a_source_needs_runs(tmp_path, made):
    bare = controllers.read(write(made, tmp_path / "x.comp"))

    with pytest.raises(SignCheckFailedError, match="nothing to dry-run"):
        controllers.write(bare, tmp_path / "y.comp")
    controllers.write(bare, tmp_path / "y.comp", verified_against=Profile(X, ERROR))


def write(table, path):
    controllers.write(table, path)
    return path
