"""Write README.txt of an offline bundle: how to install it, for which system, and the hash of each wheel."""

from __future__ import annotations

import hashlib
import platform
import sys
from pathlib import Path


def main(folder: str, extras: str) -> None:
    """Write the file."""
    place = Path(folder)
    wheels = sorted((place / "wheels").glob("*.whl"))
    rows = [f"{hashlib.sha256(w.read_bytes()).hexdigest()}  wheels/{w.name}" for w in wheels]
    python = "python" if sys.platform == "win32" else "python3"
    text = f"""metrosep without a network

For Python {".".join(platform.python_version_tuple()[:2])} on {platform.system()} {platform.machine()}.
Copy this folder to the computer, open a terminal in it and type:

    {python} -m venv metrosep-env
    metrosep-env/bin/python -m pip install --no-index --find-links wheels "metrosep[{extras}]"
    metrosep-env/bin/metrosep doctor

On Windows the folder bin is called Scripts. Nothing is fetched. SHA-256 of each file:

"""
    (place / "README.txt").write_text(text + "\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
