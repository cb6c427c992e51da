"""Beginnings of recipes that tests of several doors share."""


def mean_of_runs(files: str = "runs.csv") -> str:
    """Return a recipe of the mean of runs in one table."""
    return f"""metrosep = 1
[input]
files = ["{files}"]
x = "x_mm"
z = "z_um"
run = "run"
[[step]]
op = "separate"
method = "mean"
"""
