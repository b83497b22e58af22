"""Lower layers never import higher ones, and PETSc and MPI stay where they belong."""

import ast
import functools
import importlib
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent.parent / "pdpetsc"
# From bottom to top; a module may import from its own layer and from lower ones. The longest name counts.
LAYERS = [
    {"errors", "arrays", "bounds", "declared", "loading", "machine", "clock", "renamed"},
    {"kernels"},
    {"declare"},
    {"discrete"},
    {"gradient", "material", "bond_based", "damage"},
    {"control"},
    {"problem"},
    {"terms"},
    {"post"},
    {"case"},
    {"petsc"},
    {"solvers"},
    {"output"},
    {"running"},
    {"command_line"},
    {"decks", "studies"},
    {f"command_line.{name}" for name in ("compare", "fit", "identify", "import_deck", "study")},
    {"__init__", "__main__"},
]
# Rooms that one can delete: the core finds them by a name in a table, and imports none of them.
SATELLITES = {
    "decks": {"decks", "command_line.import_deck"},
    "studies": {"studies", *(f"command_line.{name}" for name in ("compare", "fit", "identify", "study"))},
    "event-driven solver": {"solvers.event_driven"},
    "fracture quantities": {
        "post.contour", "post.crack_path", "post.fracture", "post.inhomogeneity", "post.integrands", "post.opening",
    },
    "report": {"output.report", "command_line.report"},
}  # fmt: skip
MODULES = sorted(PACKAGE.rglob("*.py"))


@functools.cache
def tree_of(path):
    return ast.parse(path.read_text())


@functools.cache
def imported(path):
    """Return the full names of all modules and objects that a file imports, wherever in the file."""
    names = []
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return names


def is_in(name, room):
    return name == room or name.startswith(f"{room}.")


@functools.cache
def layer_of(name):
    levels = [(len(room), level) for level, rooms in enumerate(LAYERS) for room in rooms if is_in(name, room)]
    assert levels, f"{name} has no layer"
    return max(levels)[1]


def name_of(path):
    """Return the name of a module without that of the package."""
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts)


def part(path):
    relative = path.relative_to(PACKAGE)
    return relative.parts[0] if len(relative.parts) > 1 else relative.stem


def test_imports_flow_downward():
    wrong = [
        f"{path.relative_to(PACKAGE)} imports {name}"
        for path in MODULES
        for name in imported(path)
        if name.startswith("pdpetsc.") and files_of(name) is not None
        if layer_of(name.removeprefix("pdpetsc.")) > layer_of(name_of(path))
    ]
    assert not wrong


@pytest.mark.parametrize("satellite", SATELLITES)
def test_the_core_imports_no_satellite(satellite):
    others = {room for rooms in SATELLITES.values() for room in rooms}
    core = [path for path in MODULES if not any(is_in(name_of(path), room) for room in others)]
    wrong = [
        f"{path.relative_to(PACKAGE)} imports {name}"
        for path in core
        for name in set(imported(path)) - set(types_of(path))
        if any(is_in(name, f"pdpetsc.{room}") for room in SATELLITES[satellite])
    ]
    assert not wrong


def types_of(path):
    """Return what the package itself imports for type checkers alone."""
    if path != PACKAGE / "__init__.py":
        return []
    blocks = [node for node in tree_of(path).body if isinstance(node, ast.If)]
    return [
        name
        for block in blocks
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for name in (node.module, *(f"{node.module}.{alias.name}" for alias in node.names))
    ]


def test_petsc_and_mpi_stay_in_their_layers():
    for library, rooms in (("petsc4py", ("petsc", "solvers", "command_line")), ("mpi4py", ("discrete", "output"))):
        users = {path for path in MODULES for name in imported(path) if name.split(".")[0] == library}
        assert users
        assert not [str(path.relative_to(PACKAGE)) for path in users if part(path) not in rooms], library


@functools.cache
def files_of(name):
    """Return the file of a module of the package, or None for another."""
    path = PACKAGE.parent.joinpath(*name.split("."))
    for found in (path.with_suffix(".py"), path / "__init__.py"):
        if found.exists():
            return found
    return None


def test_no_file_imports_itself_by_way_of_others():
    """Also for annotations alone: what needs each other lives together."""
    ahead = {path: {files_of(name) for name in imported(path) if name.startswith("pdpetsc")} for path in MODULES}
    left = {path: found - {None, path} for path, found in ahead.items()}
    while True:
        ends = {path for path, found in left.items() if not found & left.keys()}
        if not ends:
            break
        for path in ends:
            del left[path]
    assert not left, sorted(str(path.relative_to(PACKAGE)) for path in left)


SCRIPTS = sorted((PACKAGE.parent / "runs").rglob("*.py"))


def test_what_examples_import_is_there():
    """Also where a study takes hours, which nobody runs after a name has changed."""
    wrong = []
    for path in SCRIPTS:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "pdpetsc":
                module = importlib.import_module(node.module)
                wrong += [
                    f"{path.name}: {node.module}.{alias.name}"
                    for alias in node.names
                    if not hasattr(module, alias.name) and files_of(f"{node.module}.{alias.name}") is None
                ]
    assert not wrong
