"""Nodes of quadrilaterals in a strip and of grids of hexahedra, as ``pd.MeshNodes`` makes them of a file."""

import sys
from pathlib import Path

import numpy as np

from pdpetsc.declare.cells import Block

sys.path.append(str(Path(__file__).parent.parent / "convergence"))
import common


def particles(x, y, closed=False):
    """Return particles at the nodes ``x, y`` (m + 1, n + 1), m cells along the strip and n across it.

    If the strip is closed to a ring, there are m rows of nodes.
    """
    rows, n = x.shape[0], x.shape[1] - 1
    points = np.stack([x, y], axis=2).reshape(-1, 2)
    row = np.arange(rows if closed else rows - 1)[:, None]
    first, after = ((at % rows * (n + 1) + np.arange(n)).ravel() for at in (row, row + 1))
    quads = Block("quad", np.stack([first, after, after + 1, first + 1], axis=1))
    return common.of_nodes(points, quads)


def blocks(grids):
    """Return particles at the nodes of right-handed grids of hexahedra (l, m, n, 3), which share nodes at one place."""
    cells, count = [], 0
    for grid in grids:
        node = count + np.arange(grid[..., 0].size).reshape(grid.shape[:3])
        low, high = slice(None, -1), slice(1, None)
        around = ((low, low), (high, low), (high, high), (low, high))
        cells.append(np.stack([node[i, j, k].ravel() for k in (low, high) for i, j in around], axis=1))
        count += node.size
    points = np.concatenate([grid.reshape(-1, 3) for grid in grids])
    # Nodes at one place differ by round-off.
    _, first, number = np.unique(np.round(points, 9), axis=0, return_index=True, return_inverse=True)
    return common.of_nodes(points[first], Block("hexahedron", number.reshape(-1)[np.concatenate(cells)]))
