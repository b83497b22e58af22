"""Nodes of quadrilaterals in a strip, as ``pd.MeshNodes`` makes them of a file."""

import numpy as np

import pdpetsc as pd
from pdpetsc.declare.cells import Block, facets, parts_of_facets, shares_of_nodes


def particles(x, y):
    """Return particles at the nodes ``x, y`` (m + 1, n + 1), m cells along the strip and n across it."""
    m, n = x.shape[0] - 1, x.shape[1] - 1
    points = np.stack([x, y], axis=2).reshape(-1, 2)
    first = (np.arange(m)[:, None] * (n + 1) + np.arange(n)).ravel()
    quads = Block("quad", np.stack([first, first + n + 1, first + n + 2, first + 1], axis=1))
    nodes, volume = shares_of_nodes(points, [quads])
    found = facets(points, [quads])
    node, at, area, *_ = parts_of_facets(points, found.corners[found.free], found.area[found.free])
    return pd.Arrays(points[nodes], volume, facets=pd.Facets(at, area, np.searchsorted(nodes, node)))
