"""Search from disk: excerpts of pages that a browser may not read from files, and an order that puts guides first."""

import json
from pathlib import Path

from docutils import nodes

TEXTS = "search_texts.js"
# What is added to the score of a page for the place that it is in [-]; a word in the text has 5, one in a title 15.
PLACES = {
    "start": 10, "theory/": 10, "how_to/": 10, "reference/": 3, "api/": 0, "api/generated/": -3, "examples/": -3,
    "reference/measured/": -3, "reference/papers": -10, "reference/references": -5,
}  # fmt: skip
SCRIPT = """
const ofFiles = window.fetch;
window.fetch = (url, ...more) => {
  const page = Object.keys(TEXTS).find((name) => String(url).endsWith("/" + name) || String(url) === name);
  return page === undefined ? ofFiles(url, ...more) : Promise.resolve(new Response(TEXTS[page]));
};
"""
SCORER = """
const asked = (new URLSearchParams(window.location.search).get("q") || "").toLowerCase();
var Scorer = {
  score: (result) => {
    const place = Object.keys(PLACES).filter((name) => result[0].startsWith(name)).sort((a, b) => b.length - a.length);
    // Pages that have the very words more often come first.
    const count = asked ? (TEXTS[`${result[0]}.html`] || "").toLowerCase().split(asked).length - 1 : 0;
    return result[4] + (place.length ? PLACES[place[0]] : 0) + 5 * Math.log2(1 + count);
  },
  objNameMatch: 11, objPartialMatch: 6, objPrio: {0: 15, 1: 5, 2: -5}, objPrioDefault: 0,
  title: 15, partialTitle: 7, term: 5, partialTerm: 2,
};
"""


def text_of(node):
    """Return the text of a section without equations and the sections in it."""
    left_out = (nodes.section, nodes.math_block)
    parts = [child.astext() for child in node.children if not isinstance(child, left_out)]
    return " ".join(" ".join(parts).split())


def escaped(text):
    """Return a text for HTML."""
    return text.replace("&", "&amp;").replace("<", "&lt;")


def write_texts(app, error):
    """Write the texts of all pages by their sections, as the search looks for them."""
    if error is not None or app.builder.name != "html":
        return
    texts = {}
    for page in sorted(app.env.found_docs):
        sections = app.env.get_doctree(page).findall(nodes.section)
        marked = [f'<div id="{"".join(one["ids"][:1])}">{escaped(text_of(one))}</div>' for one in sections]
        texts[f"{page}.html"] = f'<div role="main">{"".join(marked)}</div>'
    path = Path(app.outdir) / "_static" / TEXTS
    path.write_text(f"const TEXTS = {json.dumps(texts)};\n{SCRIPT}", encoding="utf-8")


def add_scripts(app, page, template, context, doctree):
    """Load the texts and the scores on the page of the search alone."""
    if page == "search":
        app.add_js_file(None, body=f"const PLACES = {json.dumps(PLACES)};\n{SCORER}", priority=1)
        app.add_js_file(TEXTS)


def setup(app):
    """Register with Sphinx."""
    app.connect("html-page-context", add_scripts)
    app.connect("build-finished", write_texts)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
