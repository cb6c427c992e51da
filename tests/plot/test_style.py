"""The style of the figures: set for a block, alone, and gone after it."""

from __future__ import annotations

import threading

import matplotlib as mpl
import pytest

from metrosep.plot.style import figure_svg, house_style


def plainly(_: object):
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.0, 2.0), layout="constrained")
    axes = figure.add_subplot()
    axes.plot([0.0, 1.0], [2.0, -1.0], label="a")
    axes.legend()
    axes.set_xlabel("x / mm")
    return figure


def test_settings_of_the_user_do_not_reach_a_figure_and_come_back():
    wanted = figure_svg(plainly, {})
    with mpl.rc_context({"font.size": 31.0, "axes.grid": False, "lines.linewidth": 9.0}):
        assert figure_svg(plainly, {}) == wanted
        assert mpl.rcParams["font.size"] == 31.0
        assert mpl.rcParams["lines.linewidth"] == 9.0


def test_a_block_within_a_block_ends_neither():
    before = mpl.rcParams["font.size"]
    with house_style():
        size = mpl.rcParams["font.size"]
        with house_style():
            assert mpl.rcParams["font.size"] == size
        assert mpl.rcParams["font.size"] == size == 9.0
    assert mpl.rcParams["font.size"] == before


def test_an_error_in_a_block_gives_the_settings_back():
    before = dict(mpl.rcParams)
    with pytest.raises(KeyError), house_style():
        raise KeyError
    assert dict(mpl.rcParams) == before
    with house_style():
        assert mpl.rcParams["font.size"] == 9.0


def test_a_setting_changed_in_a_block_does_not_reach_the_next():
    with house_style():
        mpl.rcParams["font.size"] = 40.0
    with house_style():
        assert mpl.rcParams["font.size"] == 9.0


def test_the_file_is_what_savefig_writes():
    """Drawn once, not twice: the same picture."""
    import io

    with house_style():
        stream = io.StringIO()
        undated = {"Date": None, "Creator": None, "Type": None, "Format": None}
        plainly(None).savefig(stream, format="svg", metadata=undated)
    assert figure_svg(plainly, {}) == stream.getvalue()


def test_threads_draw_one_after_the_other_and_alike():
    wanted, found = figure_svg(plainly, {}), []
    workers = [
        threading.Thread(target=lambda: found.append(figure_svg(plainly, {}))) for _ in range(4)
    ]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert found == [wanted] * 4
    assert mpl.rcParams["font.size"] != 9.0


_IN_A_PROCESS = """
import sys
import numpy as np
import metrosep as ms
surface = ms.Surface(np.arange(12.0).reshape(3, 4) * 1e-9, "1 um", "1 um")
surface.plot()
assert "matplotlib.pyplot" not in sys.modules
import matplotlib
matplotlib.use("agg")
import matplotlib.pyplot as plt
assert plt.get_fignums() == []
axes = surface.plot()
assert plt.get_fignums() == [1] and plt.gcf() is axes.figure
own = plt.figure().add_subplot()
assert surface.plot(own) is own
assert plt.get_fignums() == [1, 2]
"""


def test_pyplot_knows_the_picture_of_somebody_who_works_with_pyplot():
    import subprocess
    import sys

    import matplotlib as mpl

    if tuple(map(int, mpl.__version__.split(".")[:2])) < (3, 11):
        pytest.skip("matplotlib before 3.11 takes no figure over")
    subprocess.run([sys.executable, "-W", "error", "-c", _IN_A_PROCESS], check=True)
