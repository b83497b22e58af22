"""The fibre in its matrix before it debonds, by finite elements: python runs/fracture/interface_elements.py prints its stiffness.

Biquadratic quadrilaterals (scikit-fem), plane strain, small strain, nu = 1/4 as that of bonds. The grips hold what lies
beyond the particles of the second layer from each end: 17 of 20 mm are free for a spacing of 1 mm. Printed are force over
pull [N / mm per mm of thickness] and the moduli of the elements beside: those whose middle is in the fibre are stiff.
"""  # noqa: E501

import numpy as np
from skfem import Basis, BilinearForm, ElementQuad2, ElementVector, MeshQuad, asm, condense, solve
from skfem.helpers import ddot, sym_grad, trace

SIDE, RADIUS, E_MATRIX, E_FIBRE, NU = 20.0, 5.0, 4000.0, 40000.0, 0.25


def stiffness(n, free=17.0):
    """Return force over pull with n elements to a millimetre."""
    half = 0.5 * free
    mesh = MeshQuad.init_tensor(np.linspace(-half, half, round(free * n) + 1), np.linspace(-10.0, 10.0, 20 * n + 1))
    basis = Basis(mesh, ElementVector(ElementQuad2()))
    middle = mesh.p[:, mesh.t].mean(axis=1)
    E = np.where(np.hypot(*middle) <= RADIUS, E_FIBRE, E_MATRIX)
    mu, lam = 0.5 * E / (1.0 + NU), E * NU / ((1.0 + NU) * (1.0 - 2.0 * NU))

    @BilinearForm
    def energy(u, v, w):
        strain = sym_grad(u)
        return w["lam"] * trace(strain) * trace(sym_grad(v)) + 2.0 * w["mu"] * ddot(strain, sym_grad(v))

    shape = (len(E), basis.X.shape[-1])
    K = asm(energy, basis, lam=np.broadcast_to(lam[:, None], shape), mu=np.broadcast_to(mu[:, None], shape))
    ends = [basis.get_dofs(lambda x, at=at: np.abs(x[0] - at) < 1e-9) for at in (-half, half)]
    u = np.zeros(basis.N)
    u[ends[0].all("u^1")], u[ends[1].all("u^1")] = -0.5, 0.5
    held = np.concatenate([end.all() for end in ends])
    u = solve(*condense(K, x=u, D=held))
    return float((K @ u)[ends[1].all("u^1")].sum())


if __name__ == "__main__":
    for n in (2, 4, 8):
        print(f"{n} elements to a millimetre: {stiffness(n):.1f}", flush=True)
