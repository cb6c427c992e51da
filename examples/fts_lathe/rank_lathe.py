"""Rank the errors of a lathe by form and wavefront, and find them again on a measured part."""

from pathlib import Path

import metrosep as ms
from metrosep.machine import Chain, identify, rank

folder, part = Path(__file__).parent, ms.forms.Toric(Rb=0.265, Rd=0.1325)
lathe = Chain.from_toml(folder / "machine.toml")
lengths = dict.fromkeys(["EXX", "EYX", "EZX", "EXC", "EYC"], "1 um")
errors = lengths | dict.fromkeys(["EAX", "EBX", "ECC", "EAC", "EBC", "B0Z"], "0.001 deg")
for how in ({"removed": "none"}, {"removed": "plane"}, {"response": "wavefront"}):
    table = rank(lathe, part, radius=20e-3, errors=errors, **how)
    print(how, table.report(), sep="\n")
wanted = ["EXX", "EYX", "EZX", "B0Z"]  # truth.csv: 2, -1.5, 3 um, 0.001 deg
found = identify(lathe, ms.read(folder / "measured.sdf"), form=part, radius=20e-3, terms=wanted)
print(found.report())
