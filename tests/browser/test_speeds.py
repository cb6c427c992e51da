"""What `make speeds` prints where the computer is too busy to draw."""

from __future__ import annotations

import bench_workbench
import pytest


def test_what_could_not_be_measured_is_a_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    bench_workbench.say("frame in three dimensions", [], 33.3)
    bench_workbench.say("frame of a section", [10.0, 30.0, 20.0], 16.0)
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("frame in three dimensions: not measured: this computer was too busy")
    assert second.startswith("frame of a section: median 20 ms of 3 (10 to 30)")


def test_the_page_of_benchmarks_says_it_too(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [("frame", [], 33.3), ("numbers", [4.0], 100.0)]
    monkeypatch.setattr(bench_workbench, "find_chromium", lambda: "chromium")
    monkeypatch.setattr(bench_workbench, "measured", lambda folder, rounds: rows)
    text = "\n".join(bench_workbench.section(rounds=1))
    assert "| frame | not measured: this computer was too busy" in text
    assert "| numbers | 4 ms | 4 to 4 ms | 100 ms |" in text
