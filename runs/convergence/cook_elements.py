"""Cook's membrane by finite elements: python runs/convergence/cook_elements.py writes cook_elements.json.

Biquadratic quadrilaterals (scikit-fem), finer towards the sides, since corners are singular; the same neo-Hookean law,
plane strain, a dead shear traction on the right, Newton's method in five steps. Stored are the displacements of all
nodes as a grid, and what half as many elements each way change, of displacement and Cauchy stress, relative and in the
L2 norm over a cloud of ``CHECK`` particles a side.
"""

import json
from functools import lru_cache
from pathlib import Path

import numpy as np

STORE = Path(__file__).with_suffix(".json")
CORNERS = np.array([[0.0, 0.0], [48.0, 44.0], [48.0, 60.0], [0.0, 44.0]])
LENGTH = 48.0
E, NU, SHEAR = 1.0, 0.3, 0.03
# Elements a side, and particles a side that they are compared at.
ELEMENTS, CHECK = 32, 32


def lame():
    """Return lambda and mu."""
    return E * NU / ((1.0 + NU) * (1.0 - 2.0 * NU)), 0.5 * E / (1.0 + NU)


def places(s):
    """Return the places (n, 2) in the membrane of (n, 2) coordinates along and across it between 0 and 1."""
    a, b = s.T
    shape = np.stack([(1.0 - a) * (1.0 - b), a * (1.0 - b), a * b, (1.0 - a) * b], axis=1)
    return shape @ CORNERS


def coordinates(x):
    """Return the coordinates between 0 and 1 of places (n, 2) in the membrane."""
    a = x[:, 0] / 48.0
    return np.stack([a, (x[:, 1] - 44.0 * a) / (44.0 - 28.0 * a)], axis=1)


def line(n):
    """Return the n + 1 coordinates of corners of elements both ways, finest at the sides."""
    s = np.linspace(0.0, 1.0, n + 1)
    return s**2 * (3.0 - 2.0 * s)


def middles(s):
    """Return coordinates with the middle of each two between them."""
    both = np.empty(2 * len(s) - 1)
    both[::2], both[1::2] = s, 0.5 * (s[:-1] + s[1:])
    return both


def solved(n):
    """Return the displacements (2 n + 1, 2 n + 1, 2) at the corners, sides and middles of n x n elements."""
    from skfem import Basis, BilinearForm, ElementQuad2, ElementVector, LinearForm, MeshQuad, asm, condense, solve

    # In units of the length, which the elements of skfem are found with.
    mesh = MeshQuad.init_tensor(line(n), line(n))
    a, b = mesh.p
    mesh = MeshQuad(places(np.stack([a, b], axis=1)).T / LENGTH, mesh.t)
    element = ElementVector(ElementQuad2())
    basis = Basis(mesh, element, intorder=6)
    right = mesh.facets_satisfying(lambda x: np.abs(x[0] - 1.0) < 1e-12)
    ends = mesh.facets[:, right]
    share = SHEAR * np.abs(np.diff(mesh.p[1, ends], axis=0)[0]) / 6.0
    load = np.bincount(basis.nodal_dofs[1, ends].ravel(), np.tile(share, 2), basis.N)
    load[basis.facet_dofs[1, right]] = 4.0 * share
    held = basis.get_dofs(lambda x: np.abs(x[0]) < 1e-12).all()
    lam, mu = lame()

    def law(du):
        F = np.asarray(du) + np.eye(2)[:, :, None, None]
        J = F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]
        G = np.array([[F[1, 1], -F[1, 0]], [-F[0, 1], F[0, 0]]]) / J
        return F, np.log(J), G

    @LinearForm
    def force(v, w):
        F, log_J, G = law(w["u"].grad)
        return np.einsum("ij...,ij...", mu * F + (lam * log_J - mu) * G, np.asarray(v.grad))

    @BilinearForm
    def tangent(u, v, w):
        _, log_J, G = law(w["u"].grad)
        du, dv = np.asarray(u.grad), np.asarray(v.grad)
        found = mu * np.einsum("ij...,ij...", du, dv)
        found += lam * np.einsum("ij...,ij...", G, du) * np.einsum("ij...,ij...", G, dv)
        turned = np.einsum("il...,kl...,kj...->ij...", G, du, G)
        return found + (mu - lam * log_J) * np.einsum("ij...,ij...", turned, dv)

    u = np.zeros(basis.N)
    free = np.setdiff1d(np.arange(basis.N), held)
    for share in np.linspace(0.2, 1.0, 5):
        for _ in range(30):
            now = basis.interpolate(u)
            r = share * load - asm(force, basis, u=now)
            if np.linalg.norm(r[free]) <= 1e-9 * np.linalg.norm(load):
                break
            u = u + solve(*condense(asm(tangent, basis, u=now), r, D=held))
        else:
            raise RuntimeError("Newton's method has not converged")
    # Nodes on the grid of corners, sides and middles, by their coordinates.
    s = coordinates(LENGTH * basis.doflocs.T)
    grid = [np.argmin(np.abs(s[:, [axis]] - middles(line(n))), axis=1) for axis in (0, 1)]
    component = np.zeros(basis.N, dtype=int)
    component[basis.split_indices()[1]] = 1
    values = np.full((2 * n + 1, 2 * n + 1, 2), np.nan)
    values[grid[0], grid[1], component] = LENGTH * u
    assert np.isfinite(values).all()
    return values


def quadratic(s, ends):
    """Return the element of coordinates ``s`` (n,), and values and slopes (n, 3) of its three functions there."""
    k = np.clip(np.searchsorted(ends, s, side="right") - 1, 0, len(ends) - 2)
    size = ends[k + 1] - ends[k]
    z = (s - ends[k]) / size
    values = np.stack([(1.0 - z) * (1.0 - 2.0 * z), 4.0 * z * (1.0 - z), z * (2.0 * z - 1.0)], axis=1)
    slopes = np.stack([4.0 * z - 3.0, 4.0 - 8.0 * z, 4.0 * z - 1.0], axis=1) / size[:, None]
    return k, values, slopes


def at(x, grid):
    """Return displacements (n, 2) and deformation gradients (n, 2, 2) at places ``x`` of a grid of node values."""
    n, s = (len(grid) - 1) // 2, coordinates(x)
    (k, A, dA), (m, B, dB) = quadratic(s[:, 0], line(n)), quadratic(s[:, 1], line(n))
    near = grid[2 * k[:, None, None] + np.arange(3)[None, :, None], 2 * m[:, None, None] + np.arange(3)[None, None, :]]
    u = np.einsum("pa,pb,pabi->pi", A, B, near)
    by_s = np.stack([np.einsum("pa,pb,pabi->pi", dA, B, near), np.einsum("pa,pb,pabi->pi", A, dB, near)], axis=2)
    # The membrane is (48 a, 44 a + b (44 - 28 a)).
    jacobian = np.zeros((len(x), 2, 2))
    jacobian[:, 0, 0] = 48.0
    jacobian[:, 1, 0], jacobian[:, 1, 1] = 44.0 - 28.0 * s[:, 1], 44.0 - 28.0 * s[:, 0]
    return u, np.eye(2) + by_s @ np.linalg.inv(jacobian)


def cauchy(F):
    """Return the Cauchy stresses of the law."""
    lam, mu = lame()
    J = np.linalg.det(F)[:, None, None]
    return (mu * (F @ F.transpose(0, 2, 1) - np.eye(2)) + lam * np.log(J) * np.eye(2)) / J


@lru_cache
def stored():
    """Return the node values that were stored."""
    return np.array(json.loads(STORE.read_text())["displacement"])


def change(one, other):
    """Return the relative change, in the L2 norm at particles, of displacement and stress from one grid to another."""
    s = (np.stack(np.meshgrid(*[np.arange(CHECK)] * 2, indexing="ij"), axis=-1).reshape(-1, 2) + 0.5) / CHECK
    x, V = places(s), 44.0 - 28.0 * s[:, 0]
    (u, F), (v, G) = at(x, one), at(x, other)
    found = []
    for a, b in ((u, v), (cauchy(F), cauchy(G))):
        a, b = a.reshape(len(V), -1), b.reshape(len(V), -1)
        found.append(float(np.sqrt((V @ (a - b) ** 2).sum() / (V @ b**2).sum())))
    return found


def main():
    grid = solved(ELEMENTS)
    grid = np.round(grid, 7)
    of_u, of_stress = change(solved(ELEMENTS // 2), grid)
    print(f"changes from half as many elements: displacement {of_u:.2e}, stress {of_stress:.2e}; corner {grid[-1, -1]}")
    stored = {"change of u": of_u, "change of the stress": of_stress, "displacement": grid.tolist()}
    STORE.write_text(json.dumps(stored) + "\n")


if __name__ == "__main__":
    main()
