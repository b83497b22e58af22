"""Cook's membrane of a nearly incompressible material in plane strain, with and without patches of one dilatation.

48 mm long, 44 and 16 mm high, clamped on the left, a dead shear traction on the right. ``law=linear``: small strain,
E = 1 N/mm2, traction 1/16; ``law=neo_hookean``: finite strain, mu = 80.194 N/mm2, traction 6.25. ``method``:
``patches``, sub-horizons with one dilatation in patches of two spacings; ``patches_control``, correspondence with the
same and Silling's control scaled with the shear modulus; ``sub_horizons``, ``control`` and ``by_shear``, without
patches, the last two with Silling's control as it is and scaled with the shear modulus. Particles are the nodes of
n x n quadrilaterals, inner ones moved by up to ``shake`` spacings. Against Taylor-Hood elements
(``cook_incompressible_elements.py``), away from the clamped corners: ``tip``, how far the upper right corner rises, its
error, the error of the pressure, relative in the L2 norm, and ``pressure_roughness``, how much of that error is not
linear over a family: what oscillates. Units mm, N.
"""

import json
import sys
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

import pdpetsc as pd

sys.path.append(str(Path(__file__).parent.parent / "convergence"))
import common
import cook_elements as membrane

STORE = Path(__file__).with_name("cook_incompressible_elements.json")
# Young's modulus of a Poisson's ratio, and traction.
LAWS = {
    "linear": (pd.LinearElastic, lambda nu: 1.0, 1.0 / 16.0),
    "neo_hookean": (pd.NeoHookean, lambda nu: 2.0 * 80.194 * (1.0 + nu), 6.25),
}
BY_SHEAR = pd.ByShear(pd.Silling())
METHODS = {
    "patches": lambda edge: (pd.MeanDilatation(pd.SubHorizons(), edge), None),
    "patches_control": lambda edge: (pd.MeanDilatation(pd.Correspondence(), edge), BY_SHEAR),
    "sub_horizons": lambda edge: (pd.SubHorizons(), None),
    "control": lambda edge: (pd.Correspondence(), pd.Silling()),
    "by_shear": lambda edge: (pd.Correspondence(), BY_SHEAR),
}
# The stress is singular at the clamped corners.
CORNER = 8.0


@lru_cache
def reference(law, nu):
    """Return tip and pressure, at the corners of elements with their coordinates, of the finite elements."""
    stored = json.loads(STORE.read_text())
    found = stored[law].get(f"{nu:g}")
    if found is None:
        raise pd.CaseError(f"Finite elements are stored for nu = {', '.join(stored[law])}, not {nu:g}.")
    return found["tip"], np.array(stored["line"]), np.array(found["pressure"])


def exact_pressure(x, law, nu):
    """Return the pressure of the finite elements, minus the in-plane mean stress, at places (n, 2)."""
    from scipy.interpolate import RegularGridInterpolator

    _, line, values = reference(law, nu)
    return RegularGridInterpolator((line, line), values)(np.clip(membrane.coordinates(x), 0.0, 1.0))


@dataclass(frozen=True)
class Pressure(pd.Quantity):
    """Error of minus the in-plane mean Cauchy stress, relative in the L2 norm, at the end of the load [-].

    With ``rough`` only what a linear function of the place over each family does not fit. On one rank.
    """

    law: str
    nu: float
    rough: bool = False

    def evaluate(self, solution):
        if solution.t < 1.0 or solution.cloud.comm.size > 1:
            return float("nan")
        x, V, families = solution.x, solution.volume, solution.problem.body.families
        exact = exact_pressure(x, self.law, self.nu)
        error = -0.5 * np.einsum("pii->p", pd.stress(solution)) - exact
        away = (np.hypot(x[:, 0], x[:, 1]) > CORNER) & (np.hypot(x[:, 0], x[:, 1] - 44.0) > CORNER)
        values = error
        if self.rough:
            values = np.zeros(len(x))
            for i in np.flatnonzero(away):
                near = np.append(i, families.neighbours[families.indptr[i] : families.indptr[i + 1]])
                fit = np.column_stack([np.ones(len(near)), x[near] - x[i]])
                values[i] = error[i] - np.linalg.lstsq(fit, error[near], rcond=None)[0][0]
        return float(np.sqrt((V * values**2)[away].sum() / (V * exact**2)[away].sum()))


def case(
    n=16, nu=0.4999, method="patches", law="linear", shake=0.0, seed=0, horizon=2.015, steps=0, share=0.5, patch=2.0,
    weights="suited",
):  # fmt: skip
    kind, young, shear = pd.choose("law", law, LAWS)
    spacing = float(np.sqrt(0.5 * membrane.LENGTH * (44.0 + 16.0)) / n)
    scheme, control = pd.choose("method", method, METHODS)(patch * spacing)
    if isinstance(scheme, pd.MeanDilatation):
        scheme = pd.MeanDilatation(scheme.scheme, scheme.patch, share)
    points, block = common.grid(n, shake, seed, (1.0, 1.0), common.cubes)
    tip = reference(law, nu)[0]
    region = pd.region

    def results(h):
        last = {name: h[name][-1] for name in ("tip", "pressure_error", "pressure_roughness")}
        return {"tip_error": last["tip"] / tip - 1.0} | {k: v for k, v in last.items() if np.isfinite(v)}

    return pd.Case(
        particles=common.of_nodes(membrane.places(points), block),
        horizon=horizon * spacing,
        material=kind(E=young(nu), nu=nu),
        scheme=scheme,
        control=control,
        weights=pd.choose("weights", weights, {"suited": None, **pd.WEIGHTS}),
        conditions=[
            pd.Displacement(region.Slab("x", high=1e-6 * membrane.LENGTH), x=0.0, y=0.0),
            pd.Traction(region.Slab("x", low=membrane.LENGTH * (1.0 - 1e-6)), y=shear),
        ],
        steps=pd.Steps(steps or (1 if law == "linear" else 4)),
        history={
            "tip": pd.At((48.0, 60.0), pd.displacement, "y"),
            "pressure_error": Pressure(law, nu),
            "pressure_roughness": Pressure(law, nu, rough=True),
        },
        results=results,
        picture=pd.Picture(pd.stress, "xx"),
    )
