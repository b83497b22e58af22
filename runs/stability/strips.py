"""Nodes of quadrilaterals in a strip, as ``pd.MeshNodes`` makes them of a file."""

import numpy as np

import pdpetsc as pd
from pdpetsc.declare.cells import Block, facets, parts_of_facets, shares_of_nodes


def particles(x, y, closed=False):
    """Return particles at the nodes ``x, y`` (m + 1, n + 1), m cells along the strip and n across it.

    If the strip is closed to a ring, there are m rows of nodes.
    """
    rows, n = x.shape[0], x.shape[1] - 1
    points = np.stack([x, y], axis=2).reshape(-1, 2)
    row = np.arange(rows if closed else rows - 1)[:, None]
    first, after = ((at % rows * (n + 1) + np.arange(n)).ravel() for at in (row, row + 1))
    quads = Block("quad", np.stack([first, after, after + 1, first + 1], axis=1))
    nodes, volume = shares_of_nodes(points, [quads])
    found = facets(points, [quads])
    node, at, area, *_ = parts_of_facets(points, found.corners[found.free], found.area[found.free])
    return pd.Arrays(points[nodes], volume, facets=pd.Facets(at, area, np.searchsorted(nodes, node)))
