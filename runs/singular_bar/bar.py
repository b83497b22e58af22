"""Bar whose modulus vanishes at its middle, pulled at its end: what each method does to the zero-energy mode.

On the left half the exact displacement is linear, so every second difference there is an oscillation. Results:
``error``, the mean relative error of the displacement; ``sawtooth``, the largest second difference over the end
displacement between x = 0.1 and 0.4; ``sawtooth_right`` the same of the displacement minus the exact one between 0.6
and 0.9. All particles nearer to an end than the horizon have the exact displacement: a support of one particle adds
oscillations of its own where the horizon is wide. ``spring`` and ``average`` are the constants C1 and C2: 0.8, 1.28, 2,
3 and 60, 150, 500, 1750 in the papers for n = 100, 200, 500, 1000 at horizon dx.
Reference: Luo, Sundararaghavan, section 5.1, Eq. (18)-(20), Table 1; Chowdhury et al., section 5.1.
"""

from dataclasses import dataclass

import numpy as np

import pdpetsc as pd

ALPHA = 0.001
BETA = 0.004 * np.sqrt(2.0)
END = 0.005


def beyond(x):
    """Return x - 1/2 where positive and inf elsewhere."""
    return np.where(x[:, 0] > 0.5 * (1.0 + 1e-12), x[:, 0] - 0.5, np.inf)


def modulus(x):
    return 1.0 / (1.0 + BETA / (2.0 * ALPHA) / np.sqrt(beyond(x)))


def exact(x, t):
    right = beyond(x)
    return ALPHA * x + BETA * np.sqrt(np.where(np.isfinite(right), right, 0.0))[:, None]


def exact_gradient(x, t):
    return (1.0 + ALPHA + 0.5 * BETA / np.sqrt(beyond(x)))[:, None, None]


@dataclass(frozen=True)
class Sawtooth(pd.Quantity):
    """Largest second difference of ``u - exact`` over the particles with low < x < high [length]."""

    low: float
    high: float

    def evaluate(self, solution):
        x = solution.model.cloud.x
        error = (solution.model.with_ghosts(solution.u) - solution.t * exact(x, 1.0))[:, 0]
        order = np.argsort(x[:, 0])
        second = np.diff(error[order], 2)
        middle = order[1:-1]
        counts = (middle < len(solution.u)) & (x[middle, 0] > self.low) & (x[middle, 0] < self.high)
        return solution.largest(float(np.abs(second[counts]).max(initial=0.0)))


def case(n=500, horizon=1.015, scheme="correspondence", order=0, sectors=0, control="none", spring=0.0, average=0.0):
    if n < 20:
        raise pd.CaseError(f"The bar needs n >= 20 particles, not {n}.")
    dx = 1.0 / (n - 1)
    chosen = pd.choose("scheme", scheme, pd.SCHEMES)
    if order:
        chosen = pd.choose("scheme with an order", scheme, ORDERED)(order)
    if sectors:
        chosen = pd.choose("scheme with sectors", scheme, {"sub_horizons": pd.SubHorizons})(sectors)
    stabilisation = pd.choose("control", control, pd.CONTROLS)
    if spring:
        stabilisation = pd.Springs(spring)
    if average:
        stabilisation = pd.AveragedDisplacement(average)
    held = (int(horizon) - 0.5) * dx
    return pd.Case(
        particles=pd.Lattice((-0.5 * dx,), (1.0 + 0.5 * dx,), dx),
        horizon=horizon * dx,
        material=pd.Graded(pd.LinearElastic(E=1.0), modulus),
        scheme=chosen,
        stabilisation=stabilisation,
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=held), x=lambda x, t: t * exact(x, t)[:, 0]),
            pd.Displacement(pd.region.Slab("x", low=1.0 - held), x=lambda x, t: t * exact(x, t)[:, 0]),
        ],
        history={
            "error": pd.RelativeError(pd.displacement, exact),
            "sawtooth": Sawtooth(0.1, 0.4),
            "sawtooth_right": Sawtooth(0.6, 0.9),
        },
        results=lambda h: {
            "error": h["error"][-1],
            "sawtooth": h["sawtooth"][-1] / END,
            "sawtooth_right": h["sawtooth_right"][-1] / END,
        },
        fields=[pd.displacement, pd.deformation_gradient],
        picture=pd.Picture(pd.displacement, "x"),
    )


ORDERED = {"corrected": pd.Corrected, "higher_order": pd.HigherOrder}
