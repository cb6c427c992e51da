"""Sphinx configuration; the build needs no network."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE / "_ext"), str(HERE.parent)]

from metrosep import __version__  # noqa: E402

project = "metrosep"
author = "The metrosep developers"
project_copyright = "2026, The metrosep developers"
release = version = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "numpydoc",
    "mathml",  # docs/_ext: formulas as MathML, which browsers draw without a script from elsewhere
    "generated_reference",  # docs/_ext: pages for the Python names, the command line, the formats
]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_build", "_ext"]
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3

html_theme = "furo"
html_title = "metrosep"
html_static_path = ["_static"]
html_copy_source = False
html_show_sphinx = False
html_theme_options = {"navigation_with_keys": False}

autodoc_typehints = "none"  # the docstrings give type, shape and unit
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
numpydoc_xref_param_type = False

nitpicky = True
nitpick_ignore_regex = [
    # Types of other packages: there is no network, so no inventory of theirs to link to.
    ("py:.*", r"(numpy|np|pandas|pd|matplotlib|scipy|click|pathlib|collections|typing|os)\..*"),
    # Built-in names, for the same reason.
    ("py:.*", r"[a-zA-Z]+(Error|Exception|Warning)|Exception|str|int|float|bool|bytes|dict|list"),
]
