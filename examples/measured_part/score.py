"""Carry the recipe out and print what was found beside the truth."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import metrosep as ms

HERE = Path(__file__).resolve().parent


def main() -> None:
    """Print one line for each quantity."""
    with (HERE / "truth.csv").open(encoding="utf-8") as file:
        truth = {row["quantity"]: float(row["value"]) for row in csv.DictReader(file)}
    measured = ms.Recipe.load(HERE / "recipe.toml").run().produced
    found, dust = measured.found, measured.stages[1].audit["taken_out"]
    R = found["R"]
    print(f"radius  {R.value * 1e3:.5f} mm, u {R.u * 1e9:.0f} nm; truth {truth['radius']:g} mm")
    print(f"dust    {dust} heights taken out; truth {truth['spikes']:g}")
    # over a full disc (r/a)^2 cos 2a has the RMS 1/sqrt(6), a cosine 1/sqrt(2)
    parts = truth["astigmatism"] / math.sqrt(6), truth["feed_marks"] / math.sqrt(2), truth["noise"]
    print(f"RMS     {found['RMS'].value * 1e9:.2f} nm; truth {math.hypot(*parts):.2f} nm")
    # the L-filter takes 2^-(2.5/0.8)^2 = 0.1 % of the marks away
    print(f"Sq      {found['Sq'].value * 1e9:.2f} nm; truth {math.hypot(*parts[1:]):.2f} nm")


if __name__ == "__main__":
    main()
