"""The site, built by

    sphinx-build -W -c notebooks/site notebooks build/site

Its pages are the guide, the notebooks (executed), the API from the docstrings, and a page per
kernel of the catalogue, written from exact data when the site is built (`kernel_pages`). Nothing
that is read comes from another host: formulas are drawn by MathJax as a file of the site.
"""

from __future__ import annotations

import sys
from importlib.metadata import files
from pathlib import Path
from typing import Any

from pygments.lexers.special import TextLexer

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import docstrings  # noqa: E402  a file beside this one
import kernel_pages  # noqa: E402

from sphtrunc import __version__  # noqa: E402
from sphtrunc.explorer.assembly import page as explorer  # noqa: E402

project = "sphtrunc"
author = "The sphtrunc developers"
copyright = author  # no year: the same bytes whenever it is built
version = release = __version__
language = "en"

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx_design",
]
exclude_patterns = [
    "README.md",
    "benchmarks",
    "figures",
    "paper",
    "verification.md",  # included by site/verification.md; the notebook says how it was made
    "**.ipynb_checkpoints",
]

myst_enable_extensions = ["amsmath", "colon_fence", "dollarmath"]
myst_heading_anchors = 3
myst_links_external_new_tab = False

nb_execution_mode = "cache"
nb_execution_raise_on_error = True
nb_execution_timeout = 240
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the types stand in the tables of arguments
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 80
add_module_names = False
toc_object_entries_show_parents = "hide"

html_theme = "pydata_sphinx_theme"
html_title = "sphtrunc"
html_static_path = [
    "_static",
    *(
        str(f.locate())
        for f in files("sphinx-mathjax-offline") or ()
        if f.name == "tex-svg-full.js"
    ),
]
html_css_files = ["site.css"]
mathjax_path = "tex-svg-full.js"  # glyphs are drawn as curves: no fonts either
mathjax3_config: dict[str, Any] = {"options": {"enableMenu": False}, "svg": {"fontCache": "none"}}
html_sidebars = {f"site/{page}": [] for page in ("explorer", "how-do-i", "truncation-error")}
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "navbar_align": "left",
    "navbar_end": ["theme-switcher"],
    "show_toc_level": 2,
    "show_prev_next": False,
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "tango",
    "pygments_dark_style": "monokai",
}


def write_explorer(app: Any) -> None:
    """The page of `sphtrunc explore`, beside the front page."""
    if app.builder.format == "html":
        Path(app.outdir, "explorer.html").write_text(explorer(), encoding="utf-8")


def setup(app: Any) -> dict[str, bool]:
    """What is written before the pages are read, and how a docstring becomes a page."""
    app.add_lexer("csv", TextLexer)
    app.connect("builder-inited", kernel_pages.write)
    app.connect("builder-inited", write_explorer)
    app.connect("autodoc-process-docstring", docstrings.process)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
