"""Error against seconds of every method and of finite elements: python runs/bench/fronts.py [folder [problem ...]].

The manufactured field on the unit square and the ring under pressure (``runs/convergence``), plane strain, linear
elastic: on a lattice or polar quadrilaterals, and on a cloud shaken by 0.2 spacings or irregular triangles. Schemes,
horizons and weights at four sizes, and linear and quadratic finite elements (scikit-fem) of the same cells. Seconds are
those of everything from positions to displacements: families, weights, sparsity, assembly, factorisation; with elements
numbering, assembly and the same factorisation by MUMPS. Medians of ``REPEATS`` runs, one rank. Errors are relative, in
the L2 norm over particles or, with elements, over the body, without the rigid motion of the three supports.

Prints the front, the methods for which no other is both faster and better, and what each needs for ``TARGETS``. Leaves
``fronts.csv``, where rows of problems that are not named are kept, and ``front.png``. It takes some twenty minutes.
"""

import csv
import dataclasses
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("convergence")

import common
import manufactured
import ring
import rings

import pdpetsc as pd

REPEATS = 3
TARGETS = (0.01, 0.001)
# Seconds that the table of errors is for.
BUDGET = 0.3
SILLING = {"scheme": "correspondence", "G": 0.5}
# What a method is called, its parameters, and its horizons in spacings.
METHODS = {
    "correspondence + Silling": (SILLING, (1.5, 2.015, 3.015)),
    "sub-horizons": ({"scheme": "sub_horizons", "G": 0.0}, (1.5, 2.015, 3.015)),
    "stress points": ({"scheme": "stress_points", "G": 0.0}, (2.015,)),
    "bond-associated": ({"scheme": "bond_associated", "G": 0.0}, (2.015,)),
}
SQUARE, RING = (12, 24, 48, 96), (6, 12, 24, 36)
# The module of each problem, the parameters of its cloud, the mesh of elements, and the sizes.
PROBLEMS = {
    "square, lattice": (manufactured, {}, "square", SQUARE),
    "square, shaken": (manufactured, {"shake": 0.2}, "shaken square", SQUARE),
    "ring, quads": (ring, {"mesh": "quads"}, "ring", RING),
    "ring, triangles": (ring, {"mesh": "triangles"}, "triangles", RING),
}
ERRORS = ("error_u", "error_stress")


def particles(folder, module, parameters):
    """Return seconds and errors of one run of the method of this project; None where it is refused."""
    case = dataclasses.replace(module.case(**parameters), fields=[], checkpoints=0)
    try:
        done = pd.run(case, folder / "last_run").summary
    except (pd.CaseError, pd.SolveError) as error:
        print(f"  {parameters}: {str(error)[:100]} ...", flush=True)
        return None
    spent = done["timings"]
    seconds = sum(spent[name] for name in ("families", "model", "pattern", "allocation", "solve") if name in spent)
    return (seconds, *(done["results"][name] for name in ERRORS))


def mesh_of(kind, n):
    """Return nodes (2, k) and cells (m, 3 or 4) of what the elements are made of."""
    if kind in ("square", "shaken square"):
        points, block = common.grid(n, 0.2 if "shaken" in kind else 0.0, 0, (1.0, 1.0), common.cubes)
    elif kind == "ring":
        points, block = rings.polar(n)
    else:
        points, block = rings.triangles(n, 0.2, 0)
    return points, block.nodes


def factorised(K, f):
    """Return the solution of a symmetric positive system by MUMPS, as the particles' is."""
    from petsc4py import PETSc

    matrix = PETSc.Mat().createAIJ(K.shape, csr=(K.indptr, K.indices, K.data), comm=PETSc.COMM_SELF)
    ksp = PETSc.KSP().create(PETSc.COMM_SELF)
    ksp.setOperators(matrix)
    ksp.setType("preonly")
    ksp.getPC().setType("cholesky")
    ksp.getPC().setFactorSolverType("mumps")
    x, b = matrix.createVecs()
    b.array = f
    ksp.solve(b, x)
    found = x.array.copy()
    for one in (ksp, matrix, x, b):
        one.destroy()
    return found


def elements(module, kind, degree, n):
    """Return seconds and errors of finite elements, linear or quadratic; round boundaries are curved with these."""
    import skfem
    from skfem.helpers import dot
    from skfem.models.elasticity import linear_elasticity

    points, cells = mesh_of(kind, n)
    quads = cells.shape[1] == 4
    plain = (skfem.MeshQuad if quads else skfem.MeshTri)(np.ascontiguousarray(points.T), np.ascontiguousarray(cells.T))
    round_one = module is ring
    mu, lam = 0.5 / 1.3, 0.3 / (1.3 * 0.4)
    before = time.perf_counter()
    mesh = plain
    if degree == 2 and round_one:
        mesh = (skfem.MeshQuad2 if quads else skfem.MeshTri2).from_mesh(plain)
        on = mesh.dofs.facet_dofs[0, plain.boundary_facets()]
        places = mesh.doflocs.copy()
        radius = np.linalg.norm(places[:, on], axis=0)
        wanted = np.where(radius < 0.5 * (rings.INNER + rings.OUTER), rings.INNER, rings.OUTER)
        places[:, on] *= wanted / radius
        mesh = dataclasses.replace(mesh, doflocs=places)
    kinds = {(True, 1): skfem.ElementQuad1, (True, 2): skfem.ElementQuad2, (False, 1): skfem.ElementTriP1,
             (False, 2): skfem.ElementTriP2}  # fmt: skip
    element = skfem.ElementVector(kinds[quads, degree]())
    basis = skfem.Basis(mesh, element, intorder=2 * degree)
    places = lambda w: w.x.reshape(2, -1).T  # noqa: E731
    back = lambda values, w: values.T.reshape(2, *w.x.shape[1:])  # noqa: E731
    pull = skfem.LinearForm(
        lambda v, w: dot(
            np.einsum("ij...,j...->i...", np.moveaxis(module.stress(places(w), 1.0).reshape(*w.x.shape[1:], 2, 2),
                                                      (-2, -1), (0, 1)), w.n), v)
    )  # fmt: skip
    f = skfem.asm(pull, skfem.FacetBasis(mesh, element, intorder=2 * degree))
    if not round_one:
        f = f + skfem.asm(
            skfem.LinearForm(lambda v, w: dot(back(manufactured.body_force(places(w), 1.0), w), v)), basis
        )
    K = skfem.asm(linear_elasticity(lam, mu), basis)
    # Three numbers hold the body, as the particles are held; the rigid motion is taken out of the error.
    at = [(-rings.OUTER, 0.0), (rings.OUTER, 0.0)] if round_one else [(0.0, 0.0), (1.0, 0.0)]
    near = [int(np.argmin(np.linalg.norm(mesh.p.T[: len(points)] - place, axis=1))) for place in at]
    held = np.array([*basis.nodal_dofs[:, near[0]], basis.nodal_dofs[1, near[1]]])
    u = np.zeros(basis.N)
    node = points[near]
    u[held] = [*module.displacement(node[:1], 1.0)[0], module.displacement(node[1:], 1.0)[0, 1]]
    free = np.setdiff1d(np.arange(basis.N), held)
    rows = K[free]
    u[free] = factorised(rows[:, free].tocsr(), f[free] - rows[:, held] @ u[held])
    seconds = time.perf_counter() - before
    return (seconds, *errors_of(skfem.Basis(mesh, element, intorder=6), u, module, lam, mu))


def errors_of(basis, u, module, lam, mu):
    """Return the relative errors of displacement, less its rigid part, and of stress in the L2 norm."""
    field = basis.interpolate(u)
    x = np.asarray(basis.global_coordinates().value).reshape(2, -1).T
    V = basis.dx.ravel()
    gradient = np.moveaxis(np.asarray(field.grad), (0, 1), (-2, -1)).reshape(-1, 2, 2)
    strain = 0.5 * (gradient + gradient.transpose(0, 2, 1))
    sigma = 2.0 * mu * strain + lam * np.trace(strain, axis1=1, axis2=2)[:, None, None] * np.eye(2)

    class Solution:
        """What the errors of the cases read."""

        t = 1.0
        volume = V

        def sum(self, values):
            return np.asarray(values)

        def select(self, region):
            return np.ones(len(V), dtype=bool)

    solution = Solution()
    solution.x = x
    solution.u, solution.sigma = np.asarray(field.value).reshape(2, -1).T, sigma
    return (
        common.ErrorL2(lambda s: s.u, module.displacement, rigid=True).evaluate(solution),
        common.ErrorL2(lambda s: s.sigma, module.stress).evaluate(solution),
    )


def median(measure, first):
    """Return the medians of the numbers of a first and more measurements; errors are those of the first."""
    seconds = [first[0], *(measure()[0] for _ in range(REPEATS - 1))]
    return (float(np.median(seconds)), *first[1:])


def measured(folder, name):
    """Yield rows of one problem: method, horizon, weights, size, seconds, errors."""
    module, cloud, kind, sizes = PROBLEMS[name]
    for scheme, (how, horizons) in METHODS.items():
        for horizon in horizons:
            for weights in ("standard", "conforming"):
                given = cloud | how | {"horizon": horizon, "weights": weights}
                particles(folder, module, given | {"n": 8})  # fills caches
                for n in sizes:
                    first = particles(folder, module, given | {"n": n})
                    if first is None:
                        break
                    found = median(lambda: particles(folder, module, given | {"n": n}), first)
                    yield name, scheme, horizon, weights, n, *found
    for degree in (1, 2):
        for n in sizes:
            n_elements = n // degree
            elements(module, kind, degree, 8)
            first = elements(module, kind, degree, n_elements)
            found = median(lambda: elements(module, kind, degree, n_elements), first)
            yield name, f"{('linear', 'quadratic')[degree - 1]} elements", "", "", n_elements, *found


def front(rows, error):
    """Return the rows for which no other is both faster and better, by seconds."""
    best, found = np.inf, []
    for row in sorted(rows, key=lambda row: row[5]):
        if row[error] < best:
            best = row[error]
            found.append(row)
    return found


def seconds_for(rows, error, target):
    """Return the seconds that a method takes for an error, between its sizes along straight lines of logarithms."""
    values, seconds = (np.log([row[place] for row in rows]) for place in (error, 5))
    if values.min() > np.log(target):
        return np.inf
    order = np.argsort(values)
    return float(np.exp(np.interp(np.log(target), values[order], seconds[order])))


def error_after(rows, error, seconds):
    """Return as text what a method has for some seconds, with < where its finest size takes less."""
    spent, values = np.log([row[5] for row in rows]), np.log([row[error] for row in rows])
    order = np.argsort(values)[::-1]
    spent, values = np.maximum.accumulate(spent[order]), values[order]
    if np.log(seconds) < spent[0]:
        return "-"
    found = np.exp(np.interp(np.log(seconds), spent, values))
    return f"{'<' if np.log(seconds) > spent[-1] else ''}{found:.1e}"


def table(rows):
    """Print what every method has for the budget, of displacement and stress of each problem."""
    names = [name for name in PROBLEMS if any(row[0] == name for row in rows)]
    print(f"\n| error after {BUDGET} s | " + " | ".join(names) + " |\n|" + "---|" * (len(names) + 1))
    for method in dict.fromkeys(label(row) for row in rows):
        cells = []
        for name in names:
            of = [row for row in rows if row[0] == name and label(row) == method]
            cells.append(" / ".join(error_after(of, place, BUDGET) for place in (6, 7)) if of else "")
        print(f"| {method} | " + " | ".join(cells) + " |")


def label(row):
    return " ".join(str(part) for part in row[1:4] if part != "")


def report(name, rows):
    """Print fronts and what every method needs for the targets, the fastest first."""
    methods = {}
    for row in rows:
        methods.setdefault(label(row), []).append(row)
    for place, error in ((6, "displacement"), (7, "stress")):
        particles_only = [row for row in rows if row[2] != ""]
        print(f"\n{name}, {error}: no method here is both faster and better than")
        for row in front(particles_only, place):
            print(f"  {label(row):48} n = {row[4]:4d} {row[5]:9.3f} s  error {row[place]:.2e}")
        for target in TARGETS if place == 6 else TARGETS[:1]:
            needed = [(seconds_for(of, place, target), what) for what, of in methods.items()]
            said = [f"{what} {seconds:.3f} s" for seconds, what in sorted(needed) if np.isfinite(seconds)]
            print(f"  error {target:g}: " + ("; ".join(said) or "none"), flush=True)


def picture(folder, rows):
    """Draw, for displacement and stress of each problem, the error of the chief methods against seconds."""
    from matplotlib.figure import Figure

    names = [name for name in PROBLEMS if any(row[0] == name for row in rows)]
    figure = Figure(figsize=(4.2 * len(names), 7.6), layout="constrained")
    plots = figure.subplots(2, len(names), squeeze=False, sharex=True)
    drawn = {
        ("correspondence + Silling", 2.015): ("C0", "correspondence + Silling, horizon 2.015"),
        ("sub-horizons", 1.5): ("C2", "sub-horizons, 1.5"),
        ("sub-horizons", 2.015): ("C1", "sub-horizons, 2.015"),
        ("bond-associated", 2.015): ("C4", "bond-associated, 2.015"),
    }
    for column, name in enumerate(names):
        for line, error in enumerate(("displacement", "stress")):
            plot = plots[line][column]
            for (scheme, horizon), (colour, said) in drawn.items():
                for weights, style in (("standard", "--"), ("conforming", "-")):
                    of = [row for row in rows if row[:4] == (name, scheme, horizon, weights)]
                    if of:
                        plot.loglog([row[5] for row in of], [row[6 + line] for row in of], style, color=colour,
                                    marker="o", markersize=3, label=f"{said}, {weights}")  # fmt: skip
            for scheme, mark in (("linear elements", "s"), ("quadratic elements", "^")):
                of = [row for row in rows if row[:2] == (name, scheme)]
                plot.loglog([row[5] for row in of], [row[6 + line] for row in of], "k:", marker=mark, markersize=4,
                            label=scheme)  # fmt: skip
            plot.set_title(f"{name}: {error}", fontsize=10)
            plot.grid(alpha=0.3)
            if line:
                plot.set_xlabel("seconds")
            if not column:
                plot.set_ylabel("relative error")
    handles = {}
    for plot in plots.ravel():
        for handle, text in zip(*plot.get_legend_handles_labels(), strict=True):
            handles.setdefault(text, handle)
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=3, fontsize=8)
    figure.savefig(folder / "front.png", dpi=90)


def stored(folder):
    """Return the rows of the table in the folder, none where there is none."""
    try:
        lines = list(csv.reader((folder / "fronts.csv").open(newline="")))[1:]
    except FileNotFoundError:
        return []
    return [
        (*line[:2], float(line[2]) if line[2] else "", line[3], int(line[4]), *map(float, line[5:])) for line in lines
    ]


def main():
    names = study.chosen(words, PROBLEMS, "problem")
    folder = study.folder_for(words, "out/fronts")
    rows = [row for row in stored(folder) if row[0] not in names]
    for name in names:
        found = []
        for row in measured(folder, name):
            found.append(row)
            print(*(f"{v:.3g}" if isinstance(v, float) else v for v in row), sep=" | ", flush=True)
        rows += found
        study.write_table(folder, "fronts", ["problem", "method", "horizon", "weights", "n", "seconds", *ERRORS], rows)
    for name in (name for name in PROBLEMS if any(row[0] == name for row in rows)):
        report(name, [row for row in rows if row[0] == name])
    table(rows)
    picture(folder, rows)


if __name__ == "__main__":
    main()
