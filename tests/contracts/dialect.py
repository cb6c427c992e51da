"""The suite that every controller's dialect inherits: write -> read -> simulate -> flip -> damage.

A test class derives from `DialectContract` and brings its data: the name of the controller, a file
written by hand after its documents, what that file does not state, and how it may be damaged.

    class TestFanuc(DialectContract):
        name = "fanuc"
        hand = HAND
        lines = ("", "N10034P1,5")                  # whatever line they replace, it is refused
        damage = (("P48\n", "P47\n"), ...)          # old, new, and words of the refusal
"""

import dataclasses
import os
import re
from pathlib import Path

import numpy as np
import pytest

from metrosep import controllers
from metrosep.compensation import CompensationMap, CompensationTable
from metrosep.controllers.registry import find
from metrosep.core.errors import DataError, ReadError, SignCheckFailedError

OTHER_AXIS = {"linuxcnc-lincurve", "sinumerik-cec", "fanuc-straightness", "isg-cross"}
"""Dialects that correct another axis than the one they look up."""

ONLY_REVERSAL = {"pmac-backlash"}
"""It holds the difference between the directions; the forward corrections stand in another file."""

MORE = {"nv200": {"rate": 2000}, "rrf": {"max_nodes": 961}}
"""What the long tables here need beyond the example."""

ROUNDING = 2e-15
"""Of sums of positions and corrections in double precision, in m."""


def waves(t, size, rng):
    """A smooth curve over t from 0 to 1, of this size, zero at 0 and not symmetric."""
    phases, cycles = rng.uniform(0, 2 * np.pi, 3), rng.uniform(0.1, 2.0, 3)
    z = sum(np.sin(2 * np.pi * c * t + p) for c, p in zip(cycles, phases, strict=True)) / 3
    return size * (z - z[0] * np.cos(np.pi * t / 2))


def table_for(name, shape):
    """A table of n positions, a spacing, a size and a seed, as the dialect takes it."""
    n, step, size, seed = shape
    rng = np.random.default_rng(seed)
    x = np.arange(n) * step
    forward = waves(x / x[-1], size, rng)
    forward[0] = 0.0
    reverse = None
    if find(name).info.directions == "two":
        reverse = forward + 0.2 * size * np.sin(np.pi * x / x[-1]) ** 2
    return CompensationTable(
        x, forward, reverse, "X", "Z" if name in OTHER_AXIS else "X", 0.0, is_exact_inverse=True
    )


def map_for(name, shape):
    """A map likewise."""
    n, step, size, seed = shape
    rng = np.random.default_rng(seed)
    x, y = np.arange(n) * step, np.arange(max(n // 2, 3)) * 2 * step
    values = np.outer(1.0 + waves(y / y[-1], 1.0, rng) / 2, waves(x / x[-1], size, rng))
    if "product" not in name:
        values = values + np.outer(waves(y / y[-1], size, rng), np.cos(x / x[-1]))
    values[0, 0] = 0.0
    if "product" in name:
        values[:, 0] = 0.0
    return CompensationMap(x, y, values, ("X", "Y"), "Z", (0.0, 0.0))


class DialectContract:
    """What is asked of every controller; a derived class brings its data."""

    name = ""
    hand = None
    """A file written by hand; None where the tests of the dialect build theirs."""

    reading = ()
    """What the file does not state: pairs of an option and its value."""

    lines = ()
    """Lines that are refused in the place of any line."""

    damage = ()
    """Pairs of old and new text, with the words of the refusal where they matter."""

    whole = ""
    """The end of the file that may be missing."""

    end = "\n"
    kept = ()
    """Numbers of lines that may be anything: comments that nothing needs."""

    def decode(self, text):
        return find(self.name).decode(text.encode(), Path(os.devnull), **dict(self.reading))

    def may_be_cut(self, text):
        """Return whether a part of the file is a file, which only a sidecar knows to be cut."""
        return False

    def accepted(self, cases, kinds=(ReadError, DataError)):
        """Return the texts that are not refused in one line, with these words."""
        left = []
        for label, text, words in cases:
            try:
                self.decode(text)
            except kinds as exc:
                if re.search(words, str(exc)) and "\n" not in str(exc):
                    continue
                left.append(f"{label}: {exc}")
            else:
                left.append(label)
        return left

    # --- what follows holds for every controller ---

    def test_it_says_what_a_user_must_know(self, repository):
        dialect = find(self.name)
        info = dialect.info

        assert info.id == self.name
        assert {o.name for o in dialect.options if o.required} <= set(info.example)
        for fact in ("title", "entry", "units", "outside", "sign_status", "proof", "resolution"):
            assert getattr(info, fact), fact
        assert info.activation
        assert all(info.activation)
        assert (repository / "docs" / "controllers" / f"{info.page}.md").is_file()
        assert info.sign in ("confirmed", "documented", "stated", "unconfirmed")

    def test_what_is_flipped_is_refused_and_nothing_written(self, tmp_path):
        info = find(self.name).info
        shape = (21, 2e-3, 3e-6, 5)
        if info.carries == "polynomial" or self.name in ONLY_REVERSAL:
            pytest.skip("judged by its own tests: y of an actuator, lost motion")
        if info.carries == "map":
            right = map_for(self.name, (9, 2e-3, 3e-6, 5))

            def error(x, y):
                return -right.correction(x, y)
        else:
            right = table_for(self.name, shape)

            def error(x, *, direction=None):
                del direction  # the lost motion of a table with two columns stays
                return -right.correction(x, 1)

        given = {**info.example, **MORE.get(self.name, {})}
        given |= {"verified_against": error, "sign_confirmed": True}
        waive = ("quantisation", "resampling")
        path = tmp_path / f"x{info.suffix}"
        with pytest.raises(SignCheckFailedError, match="does not shrink"):
            controllers.write(
                dataclasses.replace(right.negated(), source=None),
                path, self.name, waive=waive, **given,
            )  # fmt: skip
        assert list(tmp_path.iterdir()) == []

        done = controllers.write(right, path, self.name, waive=waive, **given)
        left = 0.1 if getattr(right, "reverse", None) is None else 0.5
        assert done.after_rms < left * done.before_rms
        assert done.wrong_sign_pv > 1.9 * done.before_pv
        with pytest.raises(Exception, match="exists already"):
            controllers.write(right, path, self.name, waive=("dry-run", *waive), **{
                **given, "verified_against": None
            })  # fmt: skip

    def test_the_hand_written_file_is_read(self):
        if self.hand is not None:
            assert self.decode(self.hand).to_dict()

    def test_every_damaged_line_is_refused(self):
        rows = (self.hand or "").split(self.end)[:-1]
        cases = [
            ((i, line), self.end.join([*rows[:i], line, *rows[i + 1 :], ""]), "")
            for i in range(len(rows))
            for line in self.lines
            if i not in self.kept
        ]

        left = self.accepted(cases)
        assert not left, left

    def test_every_cut_file_is_refused(self):
        whole = (self.hand or "").removesuffix(self.whole)
        cuts = range(1, len(whole) - bool(self.whole))
        cases = [(n, whole[:n], "") for n in cuts if not self.may_be_cut(whole[:n])]

        left = self.accepted(cases)
        assert not left, left

    def test_every_damage_is_refused(self):
        cases = []
        for old, new, *words in self.damage:
            assert old in self.hand
            cases.append(((old, new), self.hand.replace(old, new, 1), *(words or [""])))

        left = self.accepted(cases, ReadError)
        assert not left, left
