"""The plate with a hole by finite elements: python runs/fracture/finite_elements.py writes finite_elements.json.

Biquadratic quadrilaterals (scikit-fem) on the plate with its round hole, small strain, plane strain, the ends x = 0 and
x = 150 mm moved apart by ``2 pull`` and held across. Stored per unit of pull: ``u_x`` [-] at the particles next to both
axes of the plate, 30 x 10 and 150 x 50 particles, the force on an end per thickness [MPa], and the relative change of
both from half as many elements each way.
"""

import json
import sys
from pathlib import Path

import numpy as np
from skfem import Basis, ElementQuad2, ElementVector, MeshQuad, asm, condense, solve
from skfem.models.elasticity import lame_parameters, linear_elasticity

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent.parent)]
import study

study.start("fracture")

import plate_with_hole

STORE = Path(__file__).with_suffix(".json")
LENGTH, WIDTH, RADIUS = plate_with_hole.LENGTH, plate_with_hole.WIDTH, plate_with_hole.RADIUS


def ring(n, m):
    """Return quadrilaterals between the hole and the square around it, n along each side and m across, finer inside."""
    half = 0.5 * WIDTH
    parts = None
    for turn in range(4):
        mesh = MeshQuad.init_tensor(np.linspace(-1.0, 1.0, n + 1), np.linspace(0.0, 1.0, m + 1) ** 1.5)
        s, t = mesh.p
        angle = 0.25 * np.pi * s
        inner = RADIUS * np.array([np.cos(angle), np.sin(angle)])
        x, y = (1.0 - t) * inner + t * half * np.array([np.ones_like(s), s])
        for _ in range(turn):
            x, y = -y, x
        mesh = MeshQuad(np.array([x + 0.5 * LENGTH, y + half]), mesh.t)
        parts = mesh if parts is None else parts + mesh
    return parts


def plate(n):
    """Return the plate with n elements across its width."""
    side = 0.5 * (LENGTH - WIDTH)
    across = np.linspace(0.0, WIDTH, n + 1)
    along = np.linspace(0.0, side, round(n * side / WIDTH) + 1)
    whole = ring(n, n) + MeshQuad.init_tensor(along, across) + MeshQuad.init_tensor(along + LENGTH - side, across)
    return MeshQuad(np.round(whole.p, 9), whole.t)


def solved(n, E=210e3, nu=0.33):
    """Return a function of places (2, k) that gives ``u_x`` there, and the force on an end, both per unit of pull."""
    basis = Basis(plate(n), ElementVector(ElementQuad2()))
    K = asm(linear_elasticity(*lame_parameters(E, nu)), basis)
    u = np.zeros(basis.N)
    left, right = (basis.get_dofs(lambda x, end=end: np.abs(x[0] - end) < 1e-6) for end in (0.0, LENGTH))
    u[left.all("u^1")], u[right.all("u^1")] = -1.0, 1.0
    held = np.concatenate([left.all(), right.all()])
    u = solve(*condense(K, np.zeros(basis.N), x=u, D=held))
    components = basis.split(u)

    def at(places):
        values, of_x = components[0]
        return of_x.probes(np.asarray(places)) @ values

    return at, float((K @ u)[right.all("u^1")].sum())


def lines(nx):
    """Return the places (2, k) of the particles next to the axis along the plate and to that across it."""
    dx = LENGTH / nx
    x, y = (dx * (0.5 + np.arange(round(side / dx))) for side in (LENGTH, WIDTH))
    found = []
    for places in ([x, np.full(len(x), 0.5 * (WIDTH + dx))], [np.full(len(y), 0.5 * (LENGTH + dx)), y]):
        places = np.array(places)
        outside = np.hypot(places[0] - 0.5 * LENGTH, places[1] - 0.5 * WIDTH) > RADIUS
        found.append(places[:, outside])
    return found


def main():
    (coarse, less), (fine, force) = solved(20), solved(40)
    stored = {"force": force, "change of the force": less / force - 1.0}
    for nx in (30, 150):
        for name, axis, places in zip(("along", "across"), (0, 1), lines(nx), strict=True):
            u = fine(places)
            stored[f"{nx} {name}"] = [np.round(places[axis], 6).tolist(), u.tolist()]
            stored[f"change of {nx} {name}"] = float(np.abs(coarse(places) - u).max())
    STORE.write_text(json.dumps(stored, indent=1) + "\n")
    print({key: value for key, value in stored.items() if not isinstance(value, list)})


if __name__ == "__main__":
    main()
