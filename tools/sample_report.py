"""Make the sample report of the documentation: a signed part of a batch, as PDF and as HTML.

Run with `python tools/sample_report.py [FOLDER]`; the extra `pdf` must be installed. The measured
part of the examples runs through a batch of one file, whose name gives part and serial number. The
same sources give the same bytes.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]
EXAMPLE = HERE / "examples" / "measured_part"
NAME = "MIRROR-40CC_2047.sdf"
BATCH = """metrosep = 1
extends = "recipe.toml"
[input]
files = ["*.sdf"]
[batch]
pattern = '(?P<part>[A-Z0-9-]+)_(?P<serial>[0-9]+)[.]sdf'
key = ["part", "serial"]
[report]
number = "QA-2026-0815"
issued = 2026-11-23
location = "laboratory"
temperature = "20.1 degC"
temperature_U = "0.2 K"
traceability = "Height scale: step height standard, certificate 4711 of the national institute."
laboratory = { name = "Sample Laboratory", street = "Ring 3", city = "Jena", country = "DE" }
customer = { name = "Sample Optics", city = "Zurich", country = "CH", order = "B-77" }
item = { name = "{part}", serial = "{serial}", material = "brass", condition = "clean" }
persons = { measured = "M. Messer", checked = "C. Check", released = "R. Reich" }
[[report.instrument]]
name = "coherence scanning interferometer"
serial = "I-77"
certificate = "4711"
certificate_date = 2026-06-01
due = 2027-06-01
"""
LARGEST = 600_000
"""Bytes: what the documentation may carry for one file."""


def main(target: Path) -> None:
    """Write sample-report.pdf and sample-report.html into a folder."""
    from metrosep import Recipe
    from metrosep.recipe.result import load_document
    from metrosep.report import write_html, write_pdf

    target.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        (work / "inbox").mkdir()
        shutil.copy(EXAMPLE / "measured.sdf", work / "inbox" / NAME)
        shutil.copy(EXAMPLE / "recipe.toml", work)
        (work / "batch.toml").write_text(BATCH, encoding="utf-8")
        recipe = Recipe.load(work / "batch.toml")
        report = recipe.batch(work / "inbox", out=work / "qa", scheduler="serial")
        if report.exit_code != 0:
            raise RuntimeError(f"the sample part is not accepted\n{report.summary()}")
        (result,) = (work / "qa").rglob("result.json")
        document = load_document(result)
        for write, suffix in ((write_pdf, "pdf"), (write_html, "html")):
            file = target / f"sample-report.{suffix}"
            write(document, file)
            size = file.stat().st_size
            print(f"{file.name}: {size} bytes")
            if size > LARGEST:
                raise RuntimeError(f"{file.name} has {size} bytes, more than {LARGEST}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "docs" / "_static")
