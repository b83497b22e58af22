"""A bar whose modulus vanishes beyond its middle: stiffness, exact displacement and what measures its oscillation."""

from dataclasses import dataclass

import numpy as np

import pdpetsc as pd


def beyond(x):
    """Return x - 1/2 where positive and inf elsewhere."""
    return np.where(x[:, 0] > 0.5 * (1.0 + 1e-12), x[:, 0] - 0.5, np.inf)


@dataclass(frozen=True)
class Bar:
    """``u = alpha x``, and ``beta sqrt(x - 1/2)`` more beyond the middle of the unit length.

    The modulus is ``E0`` times ``alpha / u'``, so that the stress ``E0 alpha`` is uniform.

    Parameters
    ----------
    alpha, beta : float
        Strain of the left half; size of the singular part.
    E0 : float
        Modulus of the left half [stress].
    """

    alpha: float
    beta: float
    E0: float

    def material(self):
        """Return the graded elastic material."""
        return pd.Graded(pd.LinearElastic(E=self.E0, nu=0.0), self.factor)

    def factor(self, x):
        """Return the modulus over E0."""
        return 1.0 / (1.0 + self.beta / (2.0 * self.alpha) / np.sqrt(beyond(x)))

    def exact(self, x, t):
        """Return the displacement (n, 1)."""
        right = beyond(x)
        return self.alpha * x + self.beta * np.sqrt(np.where(np.isfinite(right), right, 0.0))[:, None]

    def exact_gradient(self, x, t):
        """Return F (n, 1, 1)."""
        return (1.0 + self.alpha + 0.5 * self.beta / np.sqrt(beyond(x)))[:, None, None]

    @property
    def end(self):
        """Return the exact displacement of the right end."""
        return self.alpha + self.beta * np.sqrt(0.5)


@dataclass(frozen=True)
class Sawtooth(pd.Quantity):
    """Largest second difference of ``u`` minus the exact one over the particles with low < x < high [length]."""

    bar: Bar
    low: float
    high: float

    def evaluate(self, solution):
        x = solution.cloud.x
        error = (solution.state.u_local - solution.t * self.bar.exact(x, 1.0))[:, 0]
        order = np.argsort(x[:, 0])
        second = np.diff(error[order], 2)
        middle = order[1:-1]
        counts = (middle < len(solution.u)) & (x[middle, 0] > self.low) & (x[middle, 0] < self.high)
        return solution.largest(float(np.abs(second[counts]).max(initial=0.0)))


def scheme_of(name, order, sectors):
    """Return the scheme of that name with an order or a number of sectors where one is given."""
    if order:
        return pd.choose("scheme with an order", name, ORDERED)(order)
    if sectors:
        return pd.choose("scheme with sectors", name, {"sub_horizons": pd.SubHorizons})(sectors)
    return pd.choose("scheme", name, pd.SCHEMES)


def measures(bar):
    """Return the quantities that both cases record and the function that makes results of them."""
    history = {
        "error": pd.RelativeError(pd.displacement, bar.exact),
        "sawtooth": Sawtooth(bar, 0.1, 0.4),
        "sawtooth_right": Sawtooth(bar, 0.6, 0.9),
    }

    def results(found):
        return {
            "error": found["error"][-1],
            "sawtooth": found["sawtooth"][-1] / bar.end,
            "sawtooth_right": found["sawtooth_right"][-1] / bar.end,
        }

    return history, results


ORDERED = {"corrected": pd.Corrected, "higher_order": pd.HigherOrder}
