#!/usr/bin/python3
"""Prints the moves of a program as LinuxCNC's RS274 interpreter understands them, one JSON a line.

It needs the system's Python, since the package installs the module ``gcode`` only there. A line
is [line number, rapid, X, Y, Z, A, B, C, feed in mm/min]; lengths in mm, angles in degrees, all as
full doubles. In inverse time (G93) the interpreter makes the feed of each block from F and the
length of its way. Call: interpret.py PROGRAM PARAMETER_FILE
"""

import json
import sys

MM = 25.4  # the interpreter hands out inches


class Canon:
    """What the interpreter calls for each canonical command."""

    def __init__(self, parameters):
        self.parameter_file = parameters
        self.moves = []
        self.line = 0
        self.feed = 0.0

    def __getattr__(self, name):
        """Anything that is not a move is accepted silently."""
        if name.startswith("_"):
            raise AttributeError(name)
        return lambda *args, **named: None

    def next_line(self, state):
        """Remember the number of the block."""
        self.line = state.sequence_number

    def set_feed_rate(self, rate):
        """Remember F."""
        self.feed = rate

    def move(self, rapid, x, y, z, a, b, c, *_uvw):
        """Note a linear move."""
        self.moves.append([self.line, rapid, x * MM, y * MM, z * MM, a, b, c, self.feed * MM])

    def straight_traverse(self, *end):
        """G0."""
        self.move(True, *end)

    def straight_feed(self, *end):
        """G1."""
        self.move(False, *end)

    def arc_feed(self, *_args):
        """No program here has arcs."""
        sys.exit("interpret: an arc")

    def check_abort(self):
        """Never."""
        return False

    def get_tool(self, _pocket):
        """No tools."""
        return (-1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0)

    def change_tool(self, pocket):
        """No tools."""

    def get_external_angular_units(self):
        """Degrees."""
        return 1.0

    def get_external_length_units(self):
        """mm."""
        return 1.0 / MM

    def get_axis_mask(self):
        """X, Y, Z, C."""
        return 1 | 2 | 4 | 32

    def get_block_delete(self):
        """Optional blocks are carried out."""
        return False


def main():
    """Interpret the program."""
    import gcode  # there is none under the Python that collects the tests

    program, parameters = sys.argv[1:3]
    canon = Canon(parameters)
    code, line = gcode.parse(program, canon, "", "")
    if code > gcode.MIN_ERROR:
        sys.exit(f"interpret: line {line}: {gcode.strerror(code)}")
    for move in canon.moves:
        print(json.dumps(move))


if __name__ == "__main__":
    main()
