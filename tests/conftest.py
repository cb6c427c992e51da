"""Fixtures shared by all tests."""

import gc
import importlib.util
import io
import itertools
import math
import os
import pickle
import re
import sys
from collections.abc import Callable, Generator, Iterator
from contextlib import redirect_stderr, redirect_stdout
from hashlib import sha256
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import numpy as np
import pytest
from hypothesis import settings

REPOSITORY = Path(__file__).resolve().parents[1]

settings.register_profile("metrosep", deadline=None)
settings.load_profile(
    "metrosep"
)  # speed is measured by benches, on a machine that does nothing else


gc.set_threshold(200_000, 20, 20)  # collecting makes objects that stay


@pytest.hookimpl(wrapper=True)
def pytest_collect_file() -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    """Look for examples in the docstrings of the package only, not in those of tests."""
    found = yield
    return [collector for collector in found if type(collector) is pytest.Module]


def pytest_collection_finish() -> None:
    """Keep the collected tests out of every later walk of the garbage collector."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


class Once:
    """A separation of the same runs with the same options, made once by each worker.

    Its result is frozen, so it may be shared. That a separation repeats itself bit by bit is for
    tests that do not use this.
    """

    kept = 64

    def __init__(self, separate_runs: Callable[..., Any]) -> None:
        self.made: dict[bytes, Any] = {}
        self.separate_runs = separate_runs

    def __call__(self, *given: Any, **options: Any) -> Any:
        from metrosep.separation.runs.options import metres

        try:
            runs, method, *ends = given[:4]  # of which "45 mm" is 0.045
            same = [metres(end, "length") for end in ends]
            key = pickle.dumps((runs, method, same, given[4:], options))
        except (
            TypeError,
            AttributeError,
            ValueError,
            pickle.PicklingError,
        ):  # what a test made up
            return self.separate_runs(*given, **options)
        if key not in self.made:
            while len(self.made) >= self.kept:
                self.made.pop(next(iter(self.made)))
            self.made[key] = self.separate_runs(*given, **options)
        return self.made[key]


@pytest.fixture(scope="session")
def _once() -> Once:
    from metrosep.separation.runs import entry

    return Once(entry.separate_runs)


def _keep_separations(once: Once, patch: pytest.MonkeyPatch) -> None:
    from metrosep.separation.runs import entry

    patch.setattr(entry, "separate_runs", once)


@pytest.fixture
def separations_once(_once: Once, monkeypatch: pytest.MonkeyPatch) -> None:
    """Take a separation that this worker has made before; see `Once`."""
    _keep_separations(_once, monkeypatch)


@pytest.fixture(scope="session", autouse=True)
def _folds_kept() -> Iterator[None]:
    """Estimates without each of the runs are kept for the tests of other files that judge the same runs."""
    from metrosep.compensation import measured

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measured, "_KEPT", 16)
        yield


@pytest.fixture(scope="session")
def _uncertainties() -> dict[bytes, Any]:
    return {}


@pytest.fixture
def uncertainties_once(_uncertainties: dict[bytes, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Take what the residual of the same fit says of its uncertainty from this worker's first time."""
    _keep_uncertainties(_uncertainties, monkeypatch)


def _keep_uncertainties(_uncertainties: dict[bytes, Any], patch: pytest.MonkeyPatch) -> None:
    from metrosep.forms.points import points_of
    from metrosep.forms.result import FitResult

    really = FitResult._estimated

    def kept(fit: FitResult) -> Any:
        if fit.source is None:
            return really(fit)
        points = points_of(fit.source, centre=fit.centre, middle=False)
        how = (fit.names, fit.form, fit.placement, fit.robust, fit.covariance_of_noise)
        try:
            key = sha256(pickle.dumps((how, points, np.asarray(fit.residual.z)))).digest()
        except (TypeError, AttributeError, pickle.PicklingError):  # what a test made up
            return really(fit)
        if key not in _uncertainties:
            _uncertainties[key] = really(fit)
        return _uncertainties[key]

    patch.setattr(FitResult, "_estimated", kept)


@pytest.fixture
def command_line(monkeypatch: pytest.MonkeyPatch) -> Callable[..., CompletedProcess[str]]:
    """Run a command of metrosep in a folder, in this process: exit code and what it printed."""
    from metrosep.cli.main import main

    def run(folder: Path, *words: object) -> CompletedProcess[str]:
        out, err = io.StringIO(), io.StringIO()
        code: Any = 0
        with monkeypatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
            patch.chdir(folder)
            try:
                code = main([str(word) for word in words])
            except SystemExit as end:
                code = end.code
        return CompletedProcess(words, int(code or 0), out.getvalue(), err.getvalue())

    return run


@pytest.fixture
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write reports with empty figures, where a test reads the text or only needs the folder."""
    _draw_nothing(monkeypatch)


def _draw_nothing(patch: pytest.MonkeyPatch) -> None:
    import metrosep.plot
    from metrosep.plot import style

    for module in (metrosep.plot, style):
        patch.setattr(module, "figure_svg", lambda *_, **__: "<svg/>")


@pytest.fixture(scope="module")
def quick_doors(
    request: pytest.FixtureRequest, _once: Once, _uncertainties: dict[bytes, Any]
) -> Iterator[None]:
    """Take separations and uncertainties that were made before and draw nothing, also in fixtures of the module.

    For tests of what becomes of a result, not of whether it repeats itself; a module with ``DRAWN = True``
    looks at figures.
    """
    with pytest.MonkeyPatch.context() as patch:
        _keep_separations(_once, patch)
        _keep_uncertainties(_uncertainties, patch)
        if not getattr(request.module, "DRAWN", False):
            _draw_nothing(patch)
        yield


@pytest.fixture(scope="session")
def _kinds_drawn() -> set[tuple[str, str]]:
    return set()


@pytest.fixture
def one_figure_of_a_kind(
    _kinds_drawn: set[tuple[str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Draw the first figure of each kind for each sort of result; the others of a worker stay empty."""
    import metrosep.plot
    from metrosep.plot import style

    really = style.figure_svg

    def drawn(draw: Callable[..., Any], document: Any, **options: Any) -> str:
        kind = (
            getattr(draw, "__qualname__", repr(type(draw))),
            repr((document.get("kind"), document.get("method"), sorted(document))),
        )
        if kind in _kinds_drawn:
            return "<svg/>"
        _kinds_drawn.add(kind)
        return really(draw, document, **options)

    for module in (metrosep.plot, style):
        monkeypatch.setattr(module, "figure_svg", drawn)


_MEASURED = pytest.StashKey[list[str]]()


@pytest.fixture
def measured(request: pytest.FixtureRequest) -> Callable[[str], None]:
    """Note what a slow test measured; the lines are printed when all tests are done."""
    return request.config.stash.setdefault(_MEASURED, []).append


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Print what the slow tests measured."""
    lines = config.stash.get(_MEASURED, [])
    if lines:
        terminalreporter.section("measured")
    for line in lines:
        terminalreporter.line(line)


@pytest.fixture(scope="session")
def corpus() -> Path:
    """Folder of real instrument files; the tests that need it skip by name where it is absent."""
    folder = Path(os.environ.get("METROSEP_CORPUS", REPOSITORY.parent / "shared" / "corpus"))
    if not (folder / "MANIFEST.tsv").is_file():
        pytest.skip("corpus not found: set METROSEP_CORPUS or put it at ../shared/corpus")
    return folder


@pytest.fixture(scope="session", autouse=True)
def _state_of_tests(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Sessions of the workbench are kept away from those of the person who runs the tests."""
    folder = str(tmp_path_factory.mktemp("state"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", folder)
        patch.setenv("LOCALAPPDATA", folder)
        yield


_FOLDERS = itertools.count()


@pytest.fixture
def tmp_path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of one test, by a counter.

    The folder of pytest is numbered by a look through all earlier ones, which takes 30 s of CPU
    at the six thousandth.
    """
    n = next(_FOLDERS)
    name = re.sub(r"\W", "_", request.node.name)[:30]
    folder = tmp_path_factory.getbasetemp() / f"each{n // 200}" / f"{name}{n}"
    folder.mkdir(parents=True)
    return folder


@pytest.fixture(scope="session", autouse=True)
def _no_wait_for_the_disk() -> Iterator[None]:
    """What a test writes need not outlive the power; a test of a full disk patches over this."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture(scope="session")
def repository() -> Path:
    """Root of the checkout."""
    return REPOSITORY


@pytest.fixture
def rng() -> np.random.Generator:
    """Seeded random generator."""
    return np.random.default_rng(20260101)


@pytest.fixture
def calls() -> Callable[[Callable[[], Any]], tuple[int, Any]]:
    """Count the functions that a function calls: work in Python, the same on every machine.

    Also returned is what the function returns.
    """

    def count(function: Callable[[], Any]) -> tuple[int, Any]:
        n = 0

        def tick(_frame, event, _argument):
            nonlocal n
            n += event in ("call", "c_call")

        function()  # imports and caches
        sys.setprofile(tick)
        try:
            result = function()
        finally:
            sys.setprofile(None)
        return n, result

    return count


@pytest.fixture
def spiral_program() -> Callable[[Path, int], Path]:
    """Write a spiral of many blocks, as a long program of a lathe has them."""

    def write(path: Path, blocks: int) -> Path:
        with path.open("w") as stream:
            stream.write("%\nG21 G90 G94 G40\nG0 X20.0 C0.0\nG0 Z5.0\nG1 Z0.0 F100\nG93\n")
            for i in range(blocks):
                x, c = 20 * (1 - i / blocks), 0.5 * i
                z = 0.02 * math.sin(x) * math.cos(2 * math.radians(c))
                stream.write(f"N{i + 10} X{x:.6f} C{c:.5f} Z{z:.6f} F6000.0\n")
            stream.write("G94\nG0 Z5.0\nM30\n%\n")
        return path

    return write


@pytest.fixture(scope="session")
def contract_machine():
    """The module with the machine simulator that shares no code with metrosep."""
    path = REPOSITORY / "tests" / "contracts" / "machine.py"
    spec = importlib.util.spec_from_file_location("contract_machine", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def as_runset():
    """Turn the runs of the contract simulator into a RunSet (mm, um, mm/s to SI)."""
    from metrosep import Run, RunSet

    def convert(*machines):
        return RunSet(
            Run(x * 1e-3, z * 1e-6, t=t, feed=v * 1e-3, run_id=f"{m}.{i}")
            for m, machine in enumerate(machines)
            for i, (x, z, t, v) in enumerate(machine.runs)
        )

    return convert
