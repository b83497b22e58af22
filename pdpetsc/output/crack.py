"""``crack.vtk``: the crack of the last step as lines or surfaces."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.discrete.communicator import agreed, is_root
from pdpetsc.output.files import write_whole
from pdpetsc.output.observer import Observer
from pdpetsc.post.quantities import Quantity

FILE = "crack.vtk"


class CrackLines(Observer):
    """Write the crack of the last state, as drawn by the first quantity that draws lines or surfaces."""

    def __init__(self, quantities: Iterable[Quantity]) -> None:
        self._quantities = quantities

    def end(self) -> None:
        """Write the file. Raise OutputError on all ranks if that fails."""
        last, comm = self.observed.last, self.observed.comm
        for quantity in self._quantities:
            drawn = quantity.drawn(last)
            if drawn is not None:
                with agreed(comm):
                    if is_root(comm):
                        text = polydata(*drawn, title=f"pdpetsc, step {last.step}")
                        write_whole(self.observed.folder / FILE, text)
                return


def polydata(parts: Sequence[Float], closed: bool, title: str) -> str:
    """Return polylines or polygons as the text of a VTK file.

    Parameters
    ----------
    parts : sequence of (n, 2) or (n, 3) float64
        Points of each [length].
    closed : bool
        True for polygons.
    title : str
        The second line of the file.
    """
    points = np.zeros((sum(map(len, parts)), 3))
    if len(points):
        points[:, : parts[0].shape[1]] = np.concatenate(parts)
    lines = ["# vtk DataFile Version 3.0", title, "ASCII", "DATASET POLYDATA", f"POINTS {len(points)} double"]
    lines += [" ".join(map(repr, point)) for point in points.tolist()]
    if parts:
        lines.append(f"{'POLYGONS' if closed else 'LINES'} {len(parts)} {len(parts) + len(points)}")
        first = 0
        for part in parts:
            lines.append(" ".join(map(str, [len(part), *range(first, first + len(part))])))
            first += len(part)
    return "\n".join(lines) + "\n"
