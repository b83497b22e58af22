"""Reading finite element meshes: one reader per format, with a time limit that grows with the file.

Only the format of the ending or of the case is tried: another reader may accept a damaged file and never end.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import signal
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from pdpetsc.arrays import GlobalIndex, starts_of
from pdpetsc.declare import abaqus, exodus, gmsh
from pdpetsc.declare.cells import CORNERS, Block, MeshData
from pdpetsc.errors import CaseError

# Time limit of a reader, and its increase per byte [s].
START, PER_BYTE = 60.0, 2e-5
# Memory limit of a reader, and its increase per byte of the file [bytes]: one damaged number can request more than the
# machine has.
ROOM, ROOM_PER_BYTE = 2**30, 100
# Node orders of voxels and pixels, which are hexahedra and quadrilaterals.
_REORDERED = {"pixel": ("quad", [0, 1, 3, 2]), "voxel": ("hexahedron", [0, 1, 3, 2, 4, 5, 7, 6])}


def files_of(path: Path, name: str | None) -> list[Path]:
    """Return the files of a mesh: the file itself, and the files that it names.

    Parameters
    ----------
    path, name
        As for ``read_mesh``.
    """
    word = _by_ending(FORMATS).get(path.suffix.lower()) if name is None else name
    with contextlib.suppress(OSError, CaseError):
        if word == "abaqus" and path.is_file():
            return abaqus.files(path)
        if word == "xdmf" and path.is_file():
            return [path, *_beside(path)]
    return [path]


def _by_ending(formats: _Formats) -> dict[str, str]:
    """Return the formats by the endings of their files."""
    return {ending: word for word, (endings, _) in formats.items() for ending in endings}


def _beside(path: Path) -> list[Path]:
    """Return the data files that an XDMF file names."""
    from xml.etree import ElementTree

    found = list[Path]()
    try:
        for item in ElementTree.parse(path).iter("DataItem"):
            if item.get("Format", "").upper() in ("HDF", "BINARY") and item.text:
                name = item.text.strip().partition(":")[0]
                # HDF5 paths are relative to the folder of the file, others to the working folder.
                found += [Path(name) if item.get("Format", "").upper() == "BINARY" else path.parent / name]
    except ElementTree.ParseError:
        return []
    return list(dict.fromkeys(found))


def read_surface(path: Path) -> MeshData:
    """Read the mesh of a surface, of an STL file or as ``read_mesh``."""
    return _read(path, None, {**FORMATS, **OF_SURFACES})


def read_mesh(path: Path, name: str | None) -> MeshData:
    """Read a mesh file.

    Parameters
    ----------
    path : Path
        The file.
    name : str, optional
        The format, a key of ``FORMATS``; by default from the ending of the file.

    Raises
    ------
    CaseError
        The format is unknown, or the file is missing, damaged or not of that format.
    """
    return _read(path, name, FORMATS)


def _read(path: Path, name: str | None, formats: _Formats) -> MeshData:
    known = _by_ending(formats)
    word = known.get(path.suffix.lower()) if name is None else name
    if word is None:
        raise CaseError(
            f"Cannot tell the format of the mesh {path} from its ending; known are {', '.join(known)}. Use "
            f"Mesh(format=...), one of {', '.join(formats)}."
        )
    if not path.is_file():
        raise CaseError(f"Cannot read the mesh {path}: file not found.")
    size = path.stat().st_size
    seconds = START + PER_BYTE * size
    try:
        # meshio exits the process on some files that it cannot read, and prints its warnings.
        with (
            contextlib.redirect_stdout(io.StringIO()),
            contextlib.redirect_stderr(io.StringIO()),
            warnings.catch_warnings(),
            room(ROOM + ROOM_PER_BYTE * size),
            within(seconds),
        ):
            # numpy only warns if it drops the last numbers of a file; the mesh would be wrong.
            warnings.filterwarnings("error", message="string or file could not be read to its end")
            mesh = formats[word][1](path)
            _check(mesh)
            return mesh
    except _TooLong:
        raise CaseError(
            f"Cannot read the mesh {path} as {word}: it took more than {seconds:.0f} s. Is the format right? Convert "
            "it to another one, such as Gmsh 4.1."
        ) from None
    except MemoryError:
        raise CaseError(
            f"Cannot read the mesh {path} as {word}: {size} bytes need more memory than such a mesh should. The file "
            "is damaged or has another format."
        ) from None
    except RecursionError:
        raise CaseError(f"Cannot read the mesh {path} as {word}: it is nested too deeply.") from None
    except (Exception, SystemExit) as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise CaseError(f"Cannot read the mesh {path} as {word}: {why.rstrip('.')}.") from None


class _TooLong(BaseException):
    """Timeout of a reader; no subclass of Exception, because readers catch these."""


@contextlib.contextmanager
def within(seconds: float) -> Iterator[None]:
    """Interrupt the body after ``seconds``; no effect outside the main thread, which alone gets signals."""
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "setitimer"):
        yield
        return

    def late(number: int, frame: object) -> None:
        raise _TooLong

    handler = signal.signal(signal.SIGALRM, late)
    # The signal is repeated every second, in case a reader catches the first one.
    timer = signal.setitimer(signal.ITIMER_REAL, seconds, 1.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, handler)
        signal.setitimer(signal.ITIMER_REAL, *timer)


@contextlib.contextmanager
def room(size: int) -> Iterator[None]:
    """Limit the memory of the process to its present use plus ``size`` bytes; no effect if the use is unknown."""
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[0])
        soft, hard = resource.getrlimit(resource.RLIMIT_AS)
        limit = pages * resource.getpagesize() + size
    except (ImportError, OSError, ValueError):
        yield
        return
    if soft != resource.RLIM_INFINITY and soft <= limit:
        yield
        return
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _check(mesh: MeshData) -> None:
    """Refuse missing nodes, and coordinates that are not finite numbers."""
    points = mesh.points
    if points.ndim != 2 or not 1 <= points.shape[1] <= 3:
        raise CaseError(f"points have shape {points.shape}")
    for block in mesh.blocks:
        least = CORNERS[block.kind]
        if block.nodes.ndim != 2 or block.nodes.shape[1] < least:
            raise CaseError(f"cells of kind {block.kind} have less than {least} nodes")
        wrong = np.flatnonzero(((block.nodes < 0) | (block.nodes >= len(points))).any(axis=1))
        if len(wrong):
            raise CaseError(f"{len(wrong)} cells of kind {block.kind} name nodes that are not among the {len(points)}")
        bad = np.flatnonzero(~np.isfinite(points[block.nodes]).all(axis=(1, 2)))
        if len(bad):
            raise CaseError(f"{len(bad)} cells of kind {block.kind} have corners that are not numbers")
    n_cells = sum(len(block.nodes) for block in mesh.blocks)
    for sets, most, what in (
        (mesh.cell_sets, n_cells, "cells"), (mesh.node_sets, len(points), "nodes"),
        ({name: sides[:, 0] for name, sides in mesh.side_sets.items()}, n_cells, "cells"),
    ):  # fmt: skip
        for name, members in sets.items():
            if len(members) and (members.min() < 0 or members.max() >= most):
                raise CaseError(f"set {name!r} names {what} that are not among the {most}")


def block_of(kind: str, nodes: Any) -> Block:
    """Return the cells of a kind as named in files: ``hexahedron20`` is a hexahedron with its corners first.

    Raises
    ------
    CaseError
        The kind is unknown.
    """
    nodes = np.asarray(nodes)
    if nodes.dtype.kind not in "iu" and nodes.size:
        raise CaseError(f"nodes of cells of kind {kind} are not whole numbers")
    nodes = nodes.astype(np.int64)
    if kind in _REORDERED:
        kind, order = _REORDERED[kind]
        nodes = nodes[:, order]
    word = kind.rstrip("0123456789")
    if word not in CORNERS:
        raise CaseError(f"it has cells of kind {kind}, which particles cannot be made of")
    return Block(word, nodes)


def _read_gmsh(path: Path) -> MeshData:
    if gmsh.is_read(path):
        return gmsh.read(path)
    return _by_meshio("gmsh")(path)


def _by_meshio(name: str) -> Callable[[Path], MeshData]:
    """Return a reader of one format by meshio."""

    def read(path: Path) -> MeshData:
        return _of_meshio(importlib.import_module(f"meshio.{name}").read(path))

    return read


def _read_nastran(path: Path) -> MeshData:
    import meshio

    with path.open(errors="replace") as file:
        lines = iter(file)
        bulk = any(line.strip().startswith("BEGIN BULK") for line in lines)
        if not (bulk and any(line.startswith("ENDDATA") for line in lines)):
            raise CaseError("it has no bulk data between BEGIN BULK and ENDDATA")
    mesh = meshio.nastran.read(path)
    if np.any(mesh.point_data.get("nastran:ref", 0)):
        raise CaseError("some grid points are given in a coordinate system of their own")
    return _of_meshio(mesh)


# Mesh formats: endings and reader.
_Formats: TypeAlias = dict[str, tuple[Sequence[str], Callable[[Path], MeshData]]]
FORMATS: _Formats = {
    "gmsh": ((".msh",), _read_gmsh),
    "abaqus": ((".inp",), abaqus.read),
    "exodus": ((".e", ".exo", ".ex2", ".g", ".gen"), exodus.read),
    "vtk": ((".vtk",), _by_meshio("vtk")),
    "vtu": ((".vtu",), _by_meshio("vtu")),
    "nastran": ((".bdf", ".nas", ".fem"), _read_nastran),
    "xdmf": ((".xdmf", ".xmf"), _by_meshio("xdmf")),
    "med": ((".med",), _by_meshio("med")),
}

# The same of surfaces, which bodies cannot be made of.
OF_SURFACES: _Formats = {"stl": ((".stl",), _by_meshio("stl"))}


def _of_meshio(mesh: Any) -> MeshData:
    blocks = [block_of(block.type, block.data) for block in mesh.cells]
    starts = starts_of([len(block.nodes) for block in blocks])
    found: dict[str, list[GlobalIndex]] = {}

    def add(name: str, b: int, members: Any) -> None:
        found.setdefault(name, []).append(starts[b] + np.asarray(members, dtype=np.int64))

    for name, parts in mesh.cell_sets.items():
        for b, members in enumerate(() if name.startswith("gmsh:") else parts):
            if members is not None and len(members):
                add(name, b, members)
    for b, members, label in _groups(mesh, blocks):
        add(label, b, members)
    node_sets = {name: np.ravel(np.asarray(nodes, dtype=np.int64)) for name, nodes in mesh.point_sets.items()}
    families = getattr(mesh, "point_tags", {})
    tags = np.ravel(mesh.point_data.get("point_tags", []))
    for tag, names in families.items():
        for name in names:
            nodes = np.flatnonzero(tags == tag)
            node_sets[name] = np.concatenate([node_sets.get(name, nodes[:0]), nodes])
    cell_sets = {name: np.unique(np.concatenate(parts)) for name, parts in found.items()}
    return MeshData(np.asarray(mesh.points, dtype=float), blocks, cell_sets, {}, node_sets)


def _groups(mesh: Any, blocks: Sequence[Block]) -> Iterator[tuple[int, GlobalIndex, str]]:
    """Yield (block, cells, name) of the groups that files define by numbers of cells; 0 is no group."""
    top = max((block.dim for block in blocks), default=0)
    for key in ("gmsh:physical", "nastran:ref", "cell_tags"):
        for b, tags in enumerate(mesh.cell_data.get(key, ())):
            tags = np.ravel(tags)
            for tag in np.unique(tags):
                if tag == 0 or len(tags) != len(blocks[b].nodes):
                    continue
                if key == "cell_tags":
                    names = list(getattr(mesh, "cell_tags", {}).get(tag, ()))
                else:
                    dim = blocks[b].dim
                    names = [n for n, (number, of) in mesh.field_data.items() if number == tag and of == dim]
                    names = names or [f"group_{tag}" if dim == top else f"facets_{tag}"]
                for name in names:
                    yield b, np.flatnonzero(tags == tag), name
