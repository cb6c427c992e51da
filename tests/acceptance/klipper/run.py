"""Load a mesh with Klipper's own code and print what it adds to Z; run by test_klipper.py.

Klipper's parser of configurations, its profiles, its mesh and its splitter of moves run unchanged;
printer, G-code and toolhead around them are stand-ins. Started in a process of its own, with the
folder that holds Klipper's package `klippy` as its first argument, and a JSON job on stdin.
"""

import json
import sys
from pathlib import Path


class _Any:
    """Answers what bed_mesh.py asks of a printer, and does nothing."""

    error = ValueError

    def __getattr__(self, name):
        del name
        return lambda *args, **kwargs: _Any()

    def __str__(self):
        return ""


class _Printer(_Any):
    def lookup_object(self, name, default=None):
        del name, default
        return _Any()

    load_object = lookup_object


class _Toolhead:
    def __init__(self):
        self.moves = []

    def move(self, position, speed):
        del speed
        self.moves.append(list(position[:3]))


def main():
    """Answer the job."""
    sys.path.insert(0, str(Path(sys.argv[1])))
    import configparser

    from klippy import configfile
    from klippy.extras import bed_mesh

    job = json.load(sys.stdin)
    parser = configparser.RawConfigParser(strict=False, inline_comment_prefixes=(";", "#"))
    parser.read_string(job["config"])
    printer = _Printer()
    section = configfile.ConfigWrapper(printer, parser, {}, "bed_mesh")
    bed_mesh.BedMeshCalibrate = lambda *args: _Any()  # probing is not part of it
    mesh = bed_mesh.BedMesh(section)
    mesh.toolhead = _Toolhead()
    mesh.pmgr.load_profile(job["profile"])
    heights = [mesh.get_mesh().calc_z(x, y) for x, y in job["places"]]
    for position in job["path"]:
        mesh.move([*position, 0.0], 10.0)
    json.dump({"heights": heights, "moves": mesh.toolhead.moves}, sys.stdout)


if __name__ == "__main__":
    main()
