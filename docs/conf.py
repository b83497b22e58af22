"""How the site is built: ``make docs`` writes it to ``site/``, from where it is read without a server or a network."""

import importlib.util
import re
import sys
from pathlib import Path

import pdpetsc

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))

project = "pdpetsc"
REPOSITORY = "https://github.com/pdpetsc/pdpetsc"
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
    "excerpts",
    "links",
    "usage",
]
root_doc = "index"
exclude_patterns = ["_ext", "_templates"]
templates_path = ["_templates"]
nitpicky = True
highlight_language = "none"

myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
myst_url_schemes = ("http", "https")

autosummary_generate = True
autosummary_imported_members = True
# Classes whose methods a user calls, or writes for something of his own; of the others the parameters say all.
autosummary_context = {
    "with_members": {
        "Comparison", "Control", "ElasticMaterial", "ExtraTerm", "GradientOperator", "Hardening", "HistoryKernels",
        "HistoryMaterial", "Horizon", "IsotropicMaterial", "KeptArray", "LagrangianMaterial", "LogarithmicMaterial",
        "Material", "PointBlocks", "PointKernels", "Prepared", "Product", "Quantity", "RateLaw", "Region",
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
html_sidebars = {"index": [], "start": []}
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "logo": {"text": f"pdpetsc {release}"},
    "navbar_end": ["licence", "theme-switcher"],
    "header_links_before_dropdown": 7,
    "navigation_with_keys": False,
    "show_prev_next": True,
    # The table of the papers is as wide as it can be.
    "secondary_sidebar_items": {"**": ["page-toc"], "reference/papers": []},
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


def with_gallery(app, docname, source):
    """Show the film and link to the gallery if they have been generated, in place of what a clone has."""
    if (HERE / "examples" / "images" / "crack.gif").exists():
        source[0] = source[0].replace("(pictures/front_panel.png)", "(examples/images/crack.gif)")
    if (HERE / "examples" / "index.md").exists():
        source[0] = source[0].replace("../runs/README.md)", "examples/index.md)")
    else:
        source[0] = re.sub(r"\((?:\.\./)+runs/README\.md\)", f"({REPOSITORY}/blob/main/runs/README.md)", source[0])
        source[0] = re.sub(r"^% gallery\n.*?^% end of gallery\n", "", source[0], flags=re.MULTILINE | re.DOTALL)
        source[0] = re.sub(r"^.*\bexamples/index\b.*\n", "", source[0], flags=re.MULTILINE)


SYMBOLS = {
    "sum": "Σ", "int": "∫", "alpha": "α", "beta": "β", "delta": "δ", "eps": "ε", "eta": "η", "theta": "θ", "kappa": "κ",
    "lambda": "λ", "mu": "μ", "nu": "ν", "xi": "ξ", "pi": "π", "sigma": "σ", "tau": "τ", "phi": "φ", "psi": "ψ",
    "omega": "ω",
}  # fmt: skip
SYMBOL = re.compile(rf"(?<![A-Za-z])({'|'.join(SYMBOLS)})(?![A-Za-z])")
POWERS = {"^2": "²", "^3": "³", "^4": "⁴", "^T": "ᵀ", "^-1": "⁻¹", "^-T": "⁻ᵀ", " . ": " · ", " (x) ": " ⊗ "}
# Code that is no equation: names, calls with arguments, texts, functions.
NO_EQUATION = re.compile(r"pd\.|[\"']|\w=\w|lambda \w+:|>>>")


PROGRAM = re.compile(r"^\s*(class|def|return|for|if|import|from|with|@)", re.MULTILINE)
# A block after two colons, with its indentation.
BLOCK = re.compile(r"(?<=::\n\n)(?:(?: +\S.*)?\n)+")


def equation(code):
    """Return a piece of code of a docstring with the symbols of its equation, where it is one."""
    text = code[0]
    if PROGRAM.search(text):
        return text
    if NO_EQUATION.search(text) or not re.search(r" = |\^| / | \. |\(x\)", text):
        return text
    for said, drawn in POWERS.items():
        text = text.replace(said, drawn)
    return SYMBOL.sub(lambda name: SYMBOLS[name[1]], text)


def short_signature(app, what, name, thing, options, signature, returned):
    """Leave out of a signature what Python says of defaults that are functions or made anew."""
    if signature is None:
        return None
    signature = re.sub(r"<function (\w+)>", r"\1", signature.replace("<factory>", "..."))
    return re.sub(r"<function (\w+) at 0x\w+>", r"\1", signature), returned


def draw_equations(app, what, name, thing, options, lines):
    """Write the equations of docstrings with their symbols: ``kappa = lambda + 2 mu / dim`` as κ = λ + 2 μ / dim."""
    text = BLOCK.sub(equation, "\n".join([*lines, ""]))
    lines[:] = re.sub(r"``[^`]*``", equation, text).split("\n")[:-1]


def setup(app):
    """Register with Sphinx."""
    app.connect("source-read", with_gallery)
    app.connect("autodoc-process-signature", short_signature)
    app.connect("autodoc-process-docstring", draw_equations)
