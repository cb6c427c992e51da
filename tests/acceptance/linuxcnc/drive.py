#!/usr/bin/python3
"""The "display" of the acceptance machine: homes it, visits the targets, writes what it reads.

LinuxCNC starts this as its graphical interface and shuts down when it ends. It needs the system's
Python, since the package installs the modules ``linuxcnc`` and ``hal`` only there. It reads
``request.json`` and writes ``readings.json`` in the working directory; lengths in mm.
"""

import json
import subprocess
import sys
import time
from pathlib import Path

PINS = ("pos-cmd", "motor-pos-cmd", "backlash-corr", "backlash-filt", "motor-offset")
COMMAND_LIMIT_S = 30.0
SETTLE_LIMIT_S = 2.0
POLL_S = 0.01
OFF_S = 0.3


class Machine:
    """The running LinuxCNC, seen through its Python modules and ``halcmd``."""

    def __init__(self, deadline, more=(), axes="XZ", rest_s=0.0):
        import hal
        import linuxcnc

        self.cnc = linuxcnc
        self.hal = hal
        self.component = hal.component("drive")  # reading pins needs a component of one's own
        self.component.ready()
        self.command = linuxcnc.command()
        self.status = linuxcnc.stat()
        self.errors = linuxcnc.error_channel()
        self.messages = []
        self.deadline = deadline
        self.more = more  # full names of further pins to read
        self.axes = axes  # their letters, a joint for each
        self.rest_s = rest_s  # nothing may change for so long before a reading counts

    def wait_for(self, condition, what):
        """Poll until `condition(status)` holds; end the program at the deadline."""
        while True:
            try:
                self.status.poll()
                if condition(self.status):
                    return
            except self.cnc.error:
                pass  # the status buffer is not there in the first moments of a start
            self.drain()
            if time.monotonic() > self.deadline:
                sys.exit(f"drive: no {what} within the time limit; messages: {self.messages}")
            time.sleep(POLL_S)

    def drain(self):
        """Append all pending operator messages to ``messages``."""
        while message := self.errors.poll():
            self.messages.append({"kind": message[0], "text": message[1].strip()})

    def start(self):
        """Out of emergency stop, on, homed, ready for commands in MDI mode."""
        self.wait_for(
            lambda status: status.joints == len(self.axes), "start of the motion controller"
        )
        for state in (self.cnc.STATE_ESTOP_RESET, self.cnc.STATE_ON):
            self.command.state(state)
            self.wait_for(lambda status, state=state: status.task_state == state, f"state {state}")
        self.command.mode(self.cnc.MODE_MANUAL)
        self.command.wait_complete()
        self.command.teleop_enable(0)
        self.command.wait_complete()
        self.command.home(-1)
        self.wait_for(lambda status: all(status.homed[: len(self.axes)]), "homing")
        self.command.mode(self.cnc.MODE_MDI)
        self.command.wait_complete()

    def is_on(self, status):
        """Whether the machine is on; off it reports one of several states."""
        return status.task_state == self.cnc.STATE_ON

    def off_and_on(self):
        """Turn the machine off and on again; it stays homed."""
        for state, on in ((self.cnc.STATE_OFF, False), (self.cnc.STATE_ON, True)):
            self.command.state(state)
            self.wait_for(lambda status, on=on: self.is_on(status) == on, f"state {state}")
            time.sleep(OFF_S)
        self.command.mode(self.cnc.MODE_MDI)
        self.command.wait_complete()

    def move_to(self, target, feed):
        """Feed to `target` (one value for each axis, or fewer; mm) at `feed` (mm/min) and wait."""
        if time.monotonic() > self.deadline:
            sys.exit(f"drive: time limit reached before target {target} mm")
        words = [f"{axis}{value:.9f}" for axis, value in zip(self.axes, target, strict=False)]
        self.command.mdi(" ".join(["G1", f"F{feed:g}", *words]))
        done = self.command.wait_complete(COMMAND_LIMIT_S)
        self.drain()
        if done != self.cnc.RCS_DONE:
            sys.exit(f"drive: move to {target} mm not done (code {done}): {self.messages}")

    def read(self):
        """Pins at rest, as full doubles, and of joint 0 as ``halcmd getp`` prints them.

        ``getp`` prints seven significant digits, that is 10 nm from 10 mm on, so a difference of
        two positions has to come from the doubles; the text stays as a second witness.
        """
        since = time.monotonic()
        stop = since + SETTLE_LIMIT_S
        values = self.pins(), self.more_pins()
        while True:
            time.sleep(2 * POLL_S)
            previous, values = values, (self.pins(), self.more_pins())
            if values != previous:
                since = time.monotonic()
            elif time.monotonic() - since >= self.rest_s:
                break
            if time.monotonic() > stop:
                sys.exit(f"drive: the machine does not come to rest: {previous} then {values}")
        printed = {pin: getp(pin) for pin in ("pos-cmd", "motor-pos-cmd")}
        return {"pins_mm": values[0], "more_mm": values[1], "printed_mm": printed}

    def pins(self):
        """Values of the pins of joint 0, full precision."""
        return {pin: self.hal.get_value(f"joint.0.{pin}") for pin in PINS}

    def more_pins(self):
        """Values of the further pins that were asked for."""
        return {pin: self.hal.get_value(pin) for pin in self.more}


def getp(pin):
    """Value of a pin of joint 0 as printed by ``halcmd getp``."""
    answer = subprocess.run(
        ["halcmd", "-s", "getp", f"joint.0.{pin}"],
        capture_output=True,
        text=True,
        check=True,
        timeout=COMMAND_LIMIT_S,
    )
    return float(answer.stdout)


def main():
    """Do what ``request.json`` asks for."""
    request = json.loads(Path("request.json").read_text())
    deadline = time.monotonic() + request["limit_s"]
    machine = Machine(deadline, request["pins"], request["axes"], request["rest_s"])
    machine.start()
    at_rest = machine.read()

    readings = []
    position, direction = at_rest["pins_mm"]["pos-cmd"], 0
    for number, target in enumerate(request["targets_mm"]):
        if number in request["off_before"]:
            machine.off_and_on()
        x = target[0]
        direction = (x > position) - (x < position) or direction
        machine.move_to(target, request["feed_mm_min"])
        reading = {"target_mm": x, "target_z_mm": target[1] if len(target) > 1 else None}
        reading["targets_mm"] = target
        readings.append({**reading, "direction": direction, **machine.read()})
        position = x
    machine.drain()

    result = {
        "linuxcnc": machine.cnc.version,
        "before_first_move": at_rest,
        "readings": readings,
        "messages": machine.messages,
    }
    Path("readings.json").write_text(json.dumps(result))


if __name__ == "__main__":
    main()
