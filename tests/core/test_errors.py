"""Errors cross the border between processes, where a pool would break on one that does not."""

import copy
import pickle
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest

import metrosep as ms
from metrosep.core import errors
from metrosep.recipe.pipeline_checks import StepError

MADE = [
    errors.CorruptFileError(
        "a.x3p", "the data end", offset=12, field="x", expected=8, found=3, hint="copy it again"
    ),
    errors.RecipeError("no such key", key="feed", line=7),
    StepError("no such step", "kind"),
    *(
        getattr(errors, name)("what, where; what to do")
        for name in errors.__all__
        if name not in ("CorruptFileError", "RecipeError", "Example")
    ),
]


class TwofoldError(errors.MetrosepError, MemoryError):
    """A base that has its own way of making errors comes second."""


MADE.append(TwofoldError("what, where; what to do"))


def sent(error):
    return pickle.loads(pickle.dumps(error))  # noqa: S301  # what we have just made


@pytest.mark.parametrize("error", MADE, ids=lambda e: type(e).__name__)
@pytest.mark.parametrize("again", [sent, copy.copy])
def test_an_error_arrives_whole(error, again):
    arrived = again(error)

    assert type(arrived) is type(error)
    assert str(arrived) == str(error)
    assert vars(arrived) == vars(error)
    assert arrived.args == error.args


def test_an_error_keeps_its_notes_and_is_still_told_by_its_place():
    error = errors.RecipeError("no such key", key="feed", line=7)
    error.add_note("see the documentation")

    arrived = sent(error)

    assert arrived.__notes__ == ["see the documentation"]
    assert (arrived.key, arrived.line) == ("feed", 7)


@pytest.mark.slow
def test_reading_in_a_pool_of_processes_tells_the_file(tmp_path):
    path = tmp_path / "cut.x3p"
    path.write_bytes(b"PK\x03\x04 cut")
    with (
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool,
        pytest.raises(errors.CorruptFileError, match=r"cut\.x3p"),
    ):
        pool.submit(ms.read, path).result()


WRONG_NAMES = [
    ({"x": "nope", "z": "z_um"}, "has no x column 'nope'"),
    ({"x": "x_mm", "z": "z_nm"}, "did you mean 'z_um'"),
]


@pytest.mark.parametrize(("columns", "said"), WRONG_NAMES)
@pytest.mark.parametrize("native", [KeyError, ValueError, ms.errors.ReadError])
def test_a_column_that_is_not_there_is_an_error_of_python_too(columns, said, native, tmp_path):
    file = tmp_path / "runs.csv"
    file.write_text("x_mm,z_um\n0,1\n1,3\n2,2\n")

    with pytest.raises(native) as caught:
        ms.read_runs(file, **columns)

    assert said in str(caught.value)
    assert str(caught.value).startswith(str(file))  # a KeyError would print its repr


def test_every_error_about_what_the_caller_gave_has_a_native_base():
    for name in (
        "FormatMismatchError",
        "AmbiguousFormatError",
        "ReadNameError",
        "ReadOptionError",
    ):
        assert issubclass(getattr(errors, name), ValueError), name
