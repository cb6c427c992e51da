"""Which files the workbench may touch: those under folders that the user opened, and uploads."""

from __future__ import annotations

import os
import re
import secrets
import shutil
import tempfile
from pathlib import Path

from metrosep.core.errors import ReadError, WriteError

__all__ = ["Places"]

_SET = re.compile(r"[A-Za-z0-9]{1,40}")
_NAME = re.compile(r"[^/\\\0]{1,200}")


class Places:
    """Folders that were opened, and a folder for uploads that goes with the session."""

    def __init__(self, folders: list[Path], largest_upload: int = 4_000_000_000) -> None:
        self._roots = [Path(os.path.realpath(f)) for f in folders]
        self.largest_upload = largest_upload
        self._uploads: Path | None = None

    @property
    def roots(self) -> tuple[Path, ...]:
        """Folders that may be read and written."""
        own = () if self._uploads is None else (self._uploads,)
        return (*self._roots, *own)

    def add(self, folder: Path) -> None:
        """Open another folder."""
        self._roots.append(Path(os.path.realpath(folder)))

    def readable(self, path: str) -> Path:
        """Return a file inside the opened folders."""
        found = self.inside(path)
        if found is None:
            raise ReadError(
                f"{path}: lies outside the folders that were opened ({self._words()}); open it with "
                "'metrosep ui FILE', add its folder with --folder, or drop it onto the page"
            )
        if not found.is_file():
            raise ReadError(f"{path}: there is no such file")
        return found

    def writable(self, path: str) -> Path:
        """Return where a file may be written."""
        found = self.inside(path)
        if found is None:
            raise WriteError(
                f"{path}: lies outside the folders that were opened ({self._words()}); choose a name "
                "inside them"
            )
        if self.is_upload(found):
            where = f"choose a name in {self._roots[0]}" if self._roots else "start with --folder"
            raise WriteError(
                f"{found.name}: the folder of dropped files goes when metrosep ends, and this with it; "
                f"{where}"
            )
        if not found.parent.is_dir():
            raise WriteError(f"{path}: its folder does not exist; make it first")
        return found

    def is_upload(self, file: Path) -> bool:
        """Return whether a file lies in the folder of uploads, which goes with the session."""
        return self._uploads is not None and file.is_relative_to(self._uploads)

    def target(self, home: Path) -> Path:
        """Return the folder where results of a file go unless the user says otherwise."""
        return self._roots[0] if self.is_upload(home) and self._roots else home.parent

    def inside(self, path: str) -> Path | None:
        """Return a path without symbolic links, if it lies inside the opened folders."""
        if not path or "\0" in path or not self.roots:
            return None
        found = Path(os.path.realpath(self.roots[0] / path))
        return found if any(found.is_relative_to(root) for root in self.roots) else None

    def admits(self, path: Path) -> bool:
        """Return whether a path that a recipe names lies inside the opened folders."""
        return self.inside(str(Path.cwd() / path)) is not None

    def _words(self) -> str:
        return ", ".join(map(str, self.roots)) or "none"

    def upload(self, name: str, together: str = "") -> Path:
        """Return a new place for an uploaded file."""
        last = name.replace("\\", "/").rpartition("/")[2].strip()
        if not _NAME.fullmatch(last) or last in (".", "..") or not last.isprintable():
            raise WriteError(f"{name[:60]!r} is no file name")
        if self._uploads is None:
            try:
                made = tempfile.mkdtemp(prefix="metrosep-ui-")
            except OSError as exc:
                raise WriteError(f"{last}: there is no room for a copy ({exc.strerror})") from None
            self._uploads = Path(os.path.realpath(made))
        if together and not _SET.fullmatch(together):
            raise WriteError(
                f"{together[:60]!r} is no name of a set; it has letters and digits only"
            )
        folder = self._uploads / (f"set-{together}" if together else secrets.token_hex(4))
        try:
            folder.mkdir(exist_ok=bool(together))
        except OSError as exc:
            raise WriteError(f"{last}: there is no room for a copy ({exc.strerror})") from None
        if (folder / last).exists():
            raise WriteError(
                f"{last}: the set has a file of this name already; rename one of them"
            )
        return folder / last

    def close(self) -> None:
        """Remove the uploads."""
        if self._uploads is not None:
            shutil.rmtree(self._uploads, ignore_errors=True)
            self._uploads = None
