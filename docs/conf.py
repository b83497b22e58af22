"""How the site is built: ``make docs`` writes it to ``site/``, from where it is read without a server or a network."""

import importlib.util
import sys
from pathlib import Path

import pdpetsc

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))

project = "pdpetsc"
author = "The pdpetsc developers"
copyright = "the pdpetsc developers"
version = release = pdpetsc.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "numpydoc",
    "sphinx_copybutton",
    "sphinx_design",
    "links",
]
root_doc = "index"
exclude_patterns = ["_ext", "_templates"]
templates_path = ["_templates"]
nitpicky = True
# The gallery is generated before the site is built; without it the rest builds as well.
suppress_warnings = ["toc.empty_glob"]
highlight_language = "none"

myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
myst_url_schemes = ("http", "https")

autosummary_generate = True
autosummary_imported_members = True
# Classes whose methods a user calls, or writes for something of his own; of the others the parameters say all.
autosummary_context = {
    "with_members": {
        "Case", "Control", "ElasticMaterial", "ExtraTerm", "GradientOperator", "Hardening", "HistoryKernels",
        "HistoryMaterial", "Horizon", "IsotropicMaterial", "KeptArray", "LagrangianMaterial", "LinearisedTerm",
        "LogarithmicMaterial", "Material", "PointKernels", "PointTangent", "Prepared", "Quantity", "RateLaw", "Region",
        "Response", "Result", "Scheme", "SillingMicromodulus", "Solution", "State", "TensorResponse", "Term", "View",
        "Weights", "ZeroEnergyControl",
    },
}  # fmt: skip
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

html_theme = "pydata_sphinx_theme"
html_title = "pdpetsc"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "logo": {"text": "pdpetsc"},
    "header_links_before_dropdown": 7,
    "navigation_with_keys": False,
    "show_prev_next": True,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "tango",
    "pygments_dark_style": "github-dark",
}

# MathJax in one file of its own that draws with SVG: it needs no fonts, which browsers refuse to load from a disk.
_mathjax = importlib.util.find_spec("sphinx-mathjax-offline").submodule_search_locations[0]
html_static_path.append(str(Path(_mathjax) / "static" / "mathjax" / "tex-svg.js"))
mathjax_path = "tex-svg.js"
mathjax3_config = {"options": {"enableMenu": False}, "svg": {"fontCache": "global"}}
