"""Nine sub-apertures in; surface and reference of the interferometer against the truth out."""

import csv
from pathlib import Path

import numpy as np

import metrosep as ms
from metrosep.separation.maps.stitching import stitch

folder = Path(__file__).parent


def table(name):
    with (folder / name).open(encoding="ascii", newline="") as file:
        return list(csv.DictReader(file))


def as_map(rows):
    out = np.full(
        (1 + max(int(r["row"]) for r in rows), 1 + max(int(r["column"]) for r in rows)), np.nan
    )
    for r in rows:
        out[int(r["row"]), int(r["column"])] = float(r["z_nm"]) * 1e-9
    return out


def score(found, truth):
    """RMS difference, without piston, tilt and what surface and reference exchange unseen."""
    y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in found.shape), indexing="ij")
    basis = np.stack([np.ones(x.size), *(t.ravel() for t in (x, y, x * x, y * y, x * y))], axis=1)
    d = (found - truth).ravel()
    d = d - basis @ np.linalg.lstsq(basis, d, rcond=None)[0]
    return np.sqrt(np.mean(d**2)) * 1e9


maps = [ms.read(file) for file in sorted(folder.glob("map_*.csv"))]  # x and y tell where each lies
truth = table("truth.csv")
surface, reference = (
    as_map([r for r in truth if r["part"] == n]) for n in ("surface", "reference")
)

plain = stitch(maps)
print(f"reference ignored: surface wrong by  {score(plain.surface, surface):7.3f} nm RMS")
print(f"                   overlaps scatter  {plain.noise.value * 1e9:7.3f} nm")

result = stitch(maps, reference="fit")
for name, values in (("surface", surface), ("reference", reference)):
    u = np.sqrt(np.mean(result.u[name] ** 2)) * 1e9
    error = score(result.parts[name], values)
    print(f"reference fitted:  {name:<10}wrong by {error:6.3f} nm RMS, u {u:.3f} nm")
print(f"                   overlaps scatter  {result.noise.value * 1e9:7.3f} nm, planted 0.5 nm")
for item in result.null_space:
    print(f"not seen: {item}")
