"""What the studies share: run a case and read its history, save curves as one table and one picture.

A study starts with ``study.start()``, before it imports pdpetsc: PETSc must first see the command line.
"""

import csv
import dataclasses
import sys
from pathlib import Path

import numpy as np

RUNS = Path(__file__).parent


def start(*folders):
    """Start PETSc with the options of the command line, make case folders importable, return the other words."""
    import petsc4py

    words = sys.argv[1:]
    first = next((i for i, word in enumerate(words) if word.startswith("-")), len(words))
    petsc4py.init([sys.argv[0], *words[first:]])
    sys.path[:0] = [str(RUNS / folder) for folder in folders]
    return words[:first]


def folder_for(words, default):
    """Return the folder to write to, made on rank 0: the first word of the command line or the default."""
    from pdpetsc.discrete.communicator import is_root, world

    folder = Path(words[0] if words else default)
    if is_root(world()):
        folder.mkdir(parents=True, exist_ok=True)
    world().Barrier()
    return folder


def chosen(words, known, kind="figure"):
    """Return the names that follow the folder on the command line, or all known ones; end where one is unknown."""
    unknown = [word for word in words[1:] if word not in known]
    if unknown:
        sys.exit(f"There is no {kind} {unknown[0]}; choose from {', '.join(known)}.")
    return words[1:] or list(known)


def draw_chosen(words, functions, default, kind="figure", parts=None):
    """Call those of ``{name: function(folder)}`` that the command line names, and write the numbers they return.

    ``parts`` are more functions, of what others draw as well: they are called only where they are named.
    """
    functions = functions | (parts or {})
    names = [name for name in chosen(words, functions, kind) if words[1:] or name not in (parts or {})]
    folder = folder_for(words, default)
    numbers = {}
    for name in names:
        numbers |= functions[name](folder)
    write_numbers(folder, numbers)


def run(folder, case):
    """Run a case without files of fields; return (history, summary), or None where it did not converge."""
    import pdpetsc as pd

    try:
        done = pd.run(dataclasses.replace(case, fields=[], picture=None), output=folder / "last_run")
    except pd.SolveError:
        return None
    return {name: column.tolist() for name, column in done.history.items()}, done.summary


def write_table(folder, name, header, rows):
    """Write rows as CSV (rank 0)."""
    from pdpetsc.discrete.communicator import is_root, world

    if is_root(world()):
        with (folder / f"{name}.csv").open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(header)
            table.writerows([_text(value) for value in row] for row in rows)


def write_numbers(folder, numbers):
    """Write ``numbers.json``, one flat {name: number}, for the table of what the papers print (rank 0)."""
    import json

    from pdpetsc.discrete.communicator import is_root, world

    if is_root(world()):
        (folder / "numbers.json").write_text(json.dumps({name: float(v) for name, v in numbers.items()}, indent=1))


def write_curves(folder, name, title, columns, curves, reference=(), **axes):
    """Write curves ``{label: (x, y)}`` as one table and one picture (rank 0); labels in ``reference`` are dashed."""
    from matplotlib.figure import Figure

    from pdpetsc.discrete.communicator import is_root, world

    rows = [(label, a, b) for label, (x, y) in curves.items() for a, b in zip(x, y, strict=True)]
    write_table(folder, name, ["curve", *columns], rows)
    if not is_root(world()):
        return
    figure = Figure(figsize=(7.5, 5.0), layout="constrained")
    plot = figure.add_subplot(title=title, xlabel=columns[0], ylabel=columns[1], **axes)
    for number, (label, (x, y)) in enumerate(curves.items()):
        dashed = label in reference
        mark = "" if dashed or len(x) > 60 else "osv^D<>"[number // 10 % 7]
        plot.plot(x, y, "k--" if dashed else "-", marker=mark, markersize=4, label=label, linewidth=1.2)
    plot.grid(alpha=0.3)
    plot.legend(fontsize=8)
    figure.savefig(folder / f"{name}.png", dpi=130)
    print(f"{folder / name}.csv and .png: {title}", flush=True)


def dense_tangent(problem, u, assembler=None):
    """Return K(u) of a small problem on one process, or what another assembler makes of it, as a dense matrix."""
    from pdpetsc.problem.assembly import Assembler

    assembler = Assembler(problem) if assembler is None else assembler
    dim, rows = problem.dim, assembler.pattern.rows
    values = np.empty(dim * dim * int(rows.diag_ptr[-1]))
    assembler.assemble(problem.state(u), values, np.empty(0))
    n = problem.body.cloud.n_rows
    K = np.zeros((n, dim, n, dim))
    for a in range(n):
        first, last = rows.diag_ptr[a], rows.diag_ptr[a + 1]
        block = values[dim * dim * first : dim * dim * last].reshape(dim, last - first, dim)
        K[a][:, rows.columns[first:last], :] = block
    return K.reshape(n * dim, n * dim)


def build(case):
    """Return the problem of a case on this process."""
    from pdpetsc.discrete.communicator import world
    from pdpetsc.discrete.families import find_families
    from pdpetsc.running.build import make_cloud, make_problem

    cloud = make_cloud(world(), case)
    return make_problem(case, cloud, find_families(cloud, case.cracks))


def _text(value):
    return f"{value:.8g}" if isinstance(value, float | np.floating) else value
