"""Configuration of the book: `sphinx-build -M html notebooks notebooks/_build` makes
a site of it.

The pages need no network, neither to be built nor to be read.
"""

import os
import sys
from importlib.util import find_spec
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_extensions")]

import curlfit  # noqa: E402

project = "curlfit"
author = "The curlfit authors"
copyright = f"{author}. Licence: Apache-2.0"
version = release = curlfit.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "findings",
    "public_names",
]
exclude_patterns = ["_build", "_extensions", "**.ipynb_checkpoints"]
nitpicky = True
smartquotes = False

# Markdown that GitHub shows as well
myst_enable_extensions = ["dollarmath", "amsmath", "deflist"]
myst_heading_anchors = 4
myst_dmath_double_inline = True

# Outputs are stored in the notebooks; tests run them.
nb_execution_mode = "off"
nb_ipywidgets_js: dict[str, dict[str, str]] = {}

default_role = "literal"
autodoc_typehints = "none"
autodoc_member_order = "bysource"
python_maximum_signature_line_length = 90
add_module_names = False

html_theme = "furo"
html_title = "curlfit"
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True}
html_css_files = ["curlfit.css"]
_mathjax = find_spec("sphinx-mathjax-offline")
if _mathjax is None or _mathjax.origin is None:
    raise ImportError(
        "sphinx-mathjax-offline is not installed: pip install 'curlfit[docs]'"
    )
html_static_path = [
    "_static",
    str(Path(_mathjax.origin).parent / "static/mathjax/tex-svg.js"),
]
mathjax_path = "tex-svg.js"
html_extra_path = [".nojekyll"]
