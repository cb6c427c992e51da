"""What the tests of our habits share: the sources of the package and the files of the repository."""

import ast
import subprocess
from pathlib import Path

import pytest
from contracts.sources import trees

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def modules() -> dict[str, ast.Module]:
    """Syntax tree of every module of metrosep, by its path inside the repository."""
    assert trees()
    return {path.relative_to(REPOSITORY).as_posix(): tree for path, tree in trees().items()}


@pytest.fixture(scope="session")
def files_to_commit() -> list[Path]:
    """Files that git tracks or would add."""
    if not (REPOSITORY / ".git").exists():
        pytest.skip("not a git checkout: the list of tracked files is not known")
    listing = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        cwd=REPOSITORY,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    found = [REPOSITORY / name for name in listing.split("\0") if name]
    return [path for path in found if path.is_file()]


@pytest.fixture(autouse=True)
def _once_here(separations_once):
    """These tests ask what becomes of a separation, not whether it repeats itself."""
