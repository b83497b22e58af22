"""Links that nobody has to write: keys of the references, and public names in the text of all pages."""

import re

from docutils import nodes
from sphinx.util.nodes import make_refnode

REFERENCES = "reference/references"
KEY = re.compile(r"\b(?:[A-Z][a-z]+|de[A-Z][a-z]+)[A-Za-z]*(?:19|20)\d\d\b")
NAME = re.compile(r"^(?:pd\.|pdpetsc\.)?((?:[a-z]\w*\.)?[A-Za-z]\w*)(?=$|[(. ])")
NUMBERS = re.compile(r"^[-\d.e+<>=/%,; ]*\d[-\d.e+<>=/%,; ]*(?: ?(?:s|ms|us|MiB|GiB|KiB|kN|N|mm))?$")
# Where a name of the docstrings may be public.
ROOMS = ("", "region.", "influence.")
NO_LINKS = (nodes.reference, nodes.title, nodes.literal_block, nodes.math, nodes.math_block, nodes.raw)


def name_the_entries(app, doctree):
    """Make every entry of the list of references, which begins with its key, a target of that key."""
    if app.env.docname != REFERENCES:
        return
    for item in doctree.findall(nodes.list_item):
        strong = next(item.findall(nodes.strong), None)
        if strong is not None:
            item["ids"].append(strong.astext().lower())


def inside(node, kinds):
    """Return whether a node is part of one of these kinds."""
    while node is not None:
        if isinstance(node, kinds):
            return True
        node = node.parent
    return False


def link_keys(app, doctree, docname):
    """Make every key in the text a link to its entry."""
    if docname == REFERENCES:
        return
    known = {key for node in app.env.get_doctree(REFERENCES).findall(nodes.list_item) for key in node["ids"]}
    for text in list(doctree.findall(nodes.Text)):
        if inside(text.parent, (*NO_LINKS, nodes.literal)) or not KEY.search(text):
            continue
        parts, end = [], 0
        for match in KEY.finditer(text):
            if match[0].lower() not in known:
                continue
            parts.append(nodes.Text(text[end : match.start()]))
            parts.append(make_refnode(app.builder, docname, REFERENCES, match[0].lower(), nodes.Text(match[0])))
            end = match.end()
        text.parent.replace(text, [*parts, nodes.Text(text[end:])])


def link_names(app, doctree, docname):
    """Make every public name in code style, as ``pd.Silling(0.5)`` or ``Silling``, a link to its page."""
    objects = app.env.domains["py"].objects
    for literal in list(doctree.findall(nodes.literal)):
        if inside(literal.parent, NO_LINKS):
            continue
        said = literal.astext()
        match = NAME.match(said)
        if match is None or not (said.startswith(("pd.", "pdpetsc.")) or match[1][0].isupper()):
            continue
        found = objects.get(f"pdpetsc.{match[1]}")
        if found is None or found.docname == docname:
            continue
        link = make_refnode(app.builder, docname, found.docname, found.node_id, [literal.deepcopy()])
        literal.parent.replace(literal, link)


def link_types(app, doctree, docname):
    """Make public names in the types of parameters and among the errors, as ``Region or CaseError``, links."""
    objects = app.env.domains["py"].objects
    for node in [*doctree.findall(nodes.classifier), *doctree.findall(nodes.term)]:
        for text in list(node.findall(nodes.Text)):
            parts = []
            for word in re.split(r"(\b[A-Z]\w+\b)", text):
                names = (f"pdpetsc.{room}{word}" for room in ROOMS) if word[:1].isupper() else ()
                found = next((objects[name] for name in names if name in objects), None)
                if found is None or found.docname == docname or inside(text.parent, NO_LINKS):
                    parts.append(nodes.Text(word))
                else:
                    parts.append(make_refnode(app.builder, docname, found.docname, found.node_id, nodes.Text(word)))
            if len(parts) > 1 or isinstance(parts[0], nodes.reference):
                text.parent.replace(text, parts)


def keep_numbers_whole(doctree):
    """Mark the cells of tables that are numbers: ``1.2e-3 / 4e-5`` is not broken at its signs."""
    for entry in doctree.findall(nodes.entry):
        if len(entry.astext()) < 30 and NUMBERS.match(entry.astext()):
            entry["classes"].append("numbers")


def resolve(app, doctree, docname):
    """Put in the links of a page."""
    link_keys(app, doctree, docname)
    link_names(app, doctree, docname)
    link_types(app, doctree, docname)
    keep_numbers_whole(doctree)


def setup(app):
    """Register with Sphinx."""
    app.connect("doctree-read", name_the_entries)
    app.connect("doctree-resolved", resolve)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
