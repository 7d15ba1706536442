"""Configuration of Sphinx: the lessons become the tutorial, docstrings the reference."""

import importlib.metadata
import os
import sys
from pathlib import Path

os.environ["NUMBA_DISABLE_JIT"] = "1"  # blocks of the kernel are then functions with docstrings
sys.path.insert(0, str(Path(__file__).parent))

project = "servogym"
author = "servogym developers"
release = version = importlib.metadata.version("servogym")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "lessons"]
myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3
default_role = "literal"
html_theme = "furo"
html_show_copyright = False
html_title = f"servogym {release}"
html_static_path = ["pictures"]
exclude_patterns = ["_build"]
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "show-inheritance": True}
autodoc_typehints = "description"
autodoc_use_type_comments = False  # there are none, and looking for them takes a while
suppress_warnings = ["myst.xref_missing"]  # links to files of the repository beside the pages
