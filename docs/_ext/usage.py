"""The directive ``usage NAME``: what ``python -m pdpetsc NAME -h`` prints, from the program itself."""

from docutils import nodes
from sphinx.util.docutils import SphinxDirective

from pdpetsc.command_line.commands import usage_of


class Usage(SphinxDirective):
    """The usage of a command; ``cli`` is that of a case."""

    required_arguments = 1

    def run(self):
        """Return the text as a block."""
        text = usage_of(self.arguments[0])
        return [nodes.literal_block(text, text, language="none")]


def setup(app):
    """Register with Sphinx."""
    app.add_directive("usage", Usage)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
