"""The directive ``usage NAME``: what ``python -m pdpetsc NAME -h`` prints, from the program itself."""

from importlib import import_module

from docutils import nodes
from sphinx.util.docutils import SphinxDirective


class Usage(SphinxDirective):
    """The usage of a command; ``cli`` is that of a case."""

    required_arguments = 1

    def run(self):
        """Return the text as a block."""
        text = import_module(f"pdpetsc.command_line.{self.arguments[0]}").USAGE
        return [nodes.literal_block(text, text, language="none")]


def setup(app):
    """Register with Sphinx."""
    app.add_directive("usage", Usage)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
