"""Write what metrosep gives for all shipped examples into a folder, and compare two such folders.

    python tools/outputs.py write FOLDER [METROSEP]    every recipe, table and list of commands
    python tools/outputs.py compare BEFORE AFTER       numbers to 1e-12, all other bytes equal

Use it before and after a change that must not move a result: with the ``metrosep`` of one checkout
first, then with that of the other.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RELATIVE = 1e-12
"""Of the largest number of a list: what another order of sums may move."""

CALLS = {
    "formats.txt": ["formats"],
    "controllers.txt": ["controllers"],
    "ops.txt": ["ops"],
    "measure.json": ["measure", "data_formats/metropro/samples/format1.dat", "--form", "plane", "--json"],
    "form.json": ["form", "data_formats/metropro/samples/format1.dat", "--form", "sphere", "--json"],
    "measure_profile.json": ["measure", "examples/machine_straightness/truth.csv", "--json"],
}  # fmt: skip


def write(folder: Path, command: str) -> int:
    """Write all outputs; return how many calls ended with an error."""
    folder.mkdir(parents=True)
    failed = 0

    def call(name: str, words: list[str]) -> str:
        nonlocal failed
        done = subprocess.run(
            [command, *words], cwd=ROOT, capture_output=True, text=True, check=False
        )
        failed += done.returncode not in (0, 1, 3)
        text = f"exit {done.returncode}\n{done.stdout}"
        (folder / name).write_text(text.replace(str(folder), "OUT"))
        return done.stdout

    for name, words in CALLS.items():
        call(name, words)
    for kind in ("ops", "controllers"):
        listed = json.loads(call(f"{kind}.json", [kind, "--json"]))
        listed = listed.get(kind, listed) if isinstance(listed, dict) else listed
        names = [
            item
            if isinstance(item, str)
            else next(item[k] for k in ("op", "name", "id", "controller") if k in item)
            for item in listed
        ]
        for name in names:
            call(f"{kind}-{name}.txt", [kind, name])
    for recipe in sorted(ROOT.glob("examples/*/*.toml")):
        if not recipe.read_text(encoding="utf-8").startswith("metrosep = 1"):
            continue
        name = f"{recipe.parent.name}-{recipe.stem}"
        call(f"{name}.txt", ["run", str(recipe.relative_to(ROOT)), "-o", str(folder / name)])
    return failed


def _numbers_apart(before: Any, after: Any, where: str) -> Iterator[str]:
    """Yield where two plain values differ; numbers by `RELATIVE` of the largest of their list."""
    if isinstance(before, dict) and isinstance(after, dict):
        for key in before.keys() | after.keys():
            if key in ("version", "versions", "metrosep", "sha256"):
                continue
            if key not in before or key not in after:
                yield f"{where}.{key}: only {'after' if key in after else 'before'}"
            else:
                yield from _numbers_apart(before[key], after[key], f"{where}.{key}")
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        flat = [v for v in before if isinstance(v, float) and math.isfinite(v)]
        scale = max(map(abs, flat), default=0.0)
        for i, (a, b) in enumerate(zip(before, after, strict=True)):
            if isinstance(a, float) and isinstance(b, int | float):
                if not math.isclose(a, b, rel_tol=RELATIVE, abs_tol=RELATIVE * scale):
                    yield f"{where}[{i}]: {a!r} is {b!r}"
            else:
                yield from _numbers_apart(a, b, f"{where}[{i}]")
    elif isinstance(before, float) and isinstance(after, int | float):
        if not math.isclose(before, after, rel_tol=RELATIVE, abs_tol=0.0):
            yield f"{where}: {before!r} is {after!r}"
    elif before != after:
        yield f"{where}: {str(before)[:200]!r} is {str(after)[:200]!r}"


def compare(before: Path, after: Path) -> list[str]:
    """Return the differences of two folders, a line each."""
    found = []
    files = {p.relative_to(f) for f in (before, after) for p in f.rglob("*") if p.is_file()}
    for name in sorted(files):
        old, new = before / name, after / name
        if not old.exists() or not new.exists():
            found.append(f"{name}: only {'after' if new.exists() else 'before'}")
        elif name.suffix == ".json":
            texts = [p.read_text() for p in (old, new)]
            a, b = (
                json.loads(t.partition("\n")[2] if t.startswith("exit ") else t) for t in texts
            )
            found += [f"{name}{line}" for line in _numbers_apart(a, b, "")]
        elif old.read_bytes() != new.read_bytes():
            lines = [p.read_bytes().splitlines() for p in (old, new)]
            at = next((i for i, (a, b) in enumerate(zip(*lines, strict=False)) if a != b), 0)
            shown = [
                rows[at][:160].decode("utf-8", "replace") if rows[at:] else "" for rows in lines
            ]
            found.append(f"{name}:{at + 1}: {shown[0]!r} is {shown[1]!r}")
    return found


def main(words: list[str]) -> int:
    """Carry out ``write`` or ``compare``; the exit code is the number of failures, at most 99."""
    if words[:1] == ["write"] and len(words) in (2, 3):
        folder = Path(words[1]).resolve()
        if folder.exists():
            sys.exit(f"{folder} exists; name a folder that does not")
        beside = Path(sys.executable).with_name("metrosep")  # of the checkout that runs this
        command = words[2] if len(words) == 3 else str(beside)
        return min(99, write(folder, command))
    if words[:1] == ["compare"] and len(words) == 3:
        found = compare(Path(words[1]), Path(words[2]))
        print("\n".join(found) or "equal")
        return min(99, len(found))
    sys.exit(str(__doc__))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
