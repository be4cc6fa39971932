"""The documentation site: `make docs` builds it into build/docs."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_ext"), str(HERE.parent / "python")]

from matplotlib import get_data_path  # noqa: E402

from strainwave import __version__  # noqa: E402

project = "strainwave"
author = copyright = "The strainwave authors"
version = release = __version__

extensions = [
    "myst_nb",
    "plain_docstrings",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "mathml",
]
exclude_patterns = ["_ext"]

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 1800  # [s] the page of effects fits one arm per effect
nb_merge_streams = True

napoleon_use_param = False  # types are prose such as "(n_samples, n_joints) [rad]"
napoleon_use_rtype = False
napoleon_use_ivar = True
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_type_aliases = {
    name: f"strainwave.domain.{name}"
    for name in ("FloatArray", "BoolArray", "IntArray", "ComplexArray")
}
python_use_unqualified_type_names = True
nitpicky = True
# names in signatures that are documented elsewhere: other libraries, type aliases
nitpick_ignore_regex = [("py:(class|obj|data)", r".*")]

highlight_language = "none"  # code blocks in docstrings are equations

html_theme = "furo"
html_title = f"strainwave {__version__}"
html_math_renderer = "mathml"
# the notebooks need Matplotlib; its font has the glyphs of the equations
html_static_path = ["_static", str(Path(get_data_path()) / "fonts/ttf/DejaVuSerif.ttf")]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
