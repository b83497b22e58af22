"""Lower layers never import higher ones, and PETSc and MPI stay where they belong."""

import ast
import functools
import importlib
from pathlib import Path

PACKAGE = Path(__file__).parent.parent / "pdpetsc"
# From bottom to top; a module may import from its own layer and from lower ones.
LAYERS = [
    {"errors", "arrays", "bounds", "declared", "loading", "machine", "clock", "renamed"},
    {"kernels"},
    {"declare"},
    {"decks"},
    {"discrete"},
    {"gradient", "material", "bond_based", "damage"},
    {"control"},
    {"problem"},
    {"terms"},
    {"post"},
    {"petsc"},
    {"solvers"},
    {"output"},
    {"case"},
    {"running"},
    {"studies"},
    {"command_line", "__init__", "__main__"},
]
MODULES = sorted(PACKAGE.rglob("*.py"))


@functools.cache
def imported(path):
    """Return the full names of all modules that a file imports, wherever in the file."""
    names = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names += [node.module]
    return names


def layer_of(name):
    for level, members in enumerate(LAYERS):
        if name in members:
            return level
    raise AssertionError(f"{name} has no layer")


def part(path):
    relative = path.relative_to(PACKAGE)
    return relative.parts[0] if len(relative.parts) > 1 else relative.stem


def test_imports_flow_downward():
    wrong = [
        f"{path.relative_to(PACKAGE)} imports {name}"
        for path in MODULES
        for name in imported(path)
        if name.startswith("pdpetsc.") and layer_of(name.split(".")[1]) > layer_of(part(path))
    ]
    assert not wrong


def test_petsc_and_mpi_stay_in_their_layers():
    for library, rooms in (("petsc4py", ("petsc", "solvers", "command_line")), ("mpi4py", ("discrete", "output"))):
        users = {path for path in MODULES for name in imported(path) if name.split(".")[0] == library}
        assert users
        assert not [str(path.relative_to(PACKAGE)) for path in users if part(path) not in rooms], library


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
    # The package itself imports every part of it, lazily where that needs PETSc.
    top = PACKAGE / "__init__.py"
    left = {path: found - {None, path, top} for path, found in ahead.items() if path != top}
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
