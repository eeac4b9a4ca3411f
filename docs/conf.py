"""Sphinx's configuration: `make docs` builds these pages as a site, offline, with warnings as errors."""

from pathlib import Path

from quadlog.version import __version__

SAMPLES = Path(__file__).parents[1] / "build" / "samples" / "site"  # made by make.py

project = "quadlog"
author = "The quadlog developers"
release = version = __version__
html_title = f"quadlog {__version__}"
html_theme = "furo"
html_show_copyright = html_show_sphinx = html_copy_source = False
html_theme_options = {
    "source_repository": "https://github.com/quadlog/quadlog/",
    "source_branch": "main",
    "source_directory": "docs/",
}
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx_click"]
html_static_path = html_css_files = ["site.css"]
html_extra_path = [str(SAMPLES)] if SAMPLES.exists() else []
exclude_patterns = ["pictures"]
myst_heading_anchors = 3
myst_enable_extensions = ["colon_fence"]
smartquotes = False
default_role = "literal"
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
