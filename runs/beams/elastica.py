"""The elastica: an inextensible cantilever under a dead transverse force P at its free end.

With k^2 = (1 + sin theta) / 2 for the angle theta at the tip and sin phi = 1 / (k sqrt 2),

    sqrt(P L^2 / E I) = K(k) - F(phi, k)
    w / L = 1 - 2 (E(k) - E(phi, k)) / (K(k) - F(phi, k))
    1 - u / L = sqrt(2 sin theta) / (K(k) - F(phi, k))

(Bisshopp and Drucker 1945; Mattiasson 1981 tabulates it: 0.81061 and 0.55500 at P L^2 / E I = 10).
"""

import math

from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc


def tip(load):
    """Return w / L and u / L of the tip under ``load`` = P L^2 / E I > 0."""

    def parts(m):
        phi = math.asin(1.0 / math.sqrt(2.0 * m))
        return ellipk(m) - ellipkinc(phi, m), ellipe(m) - ellipeinc(phi, m)

    m = brentq(lambda m: parts(m)[0] - math.sqrt(load), 0.5 * (1.0 + 1e-14), 1.0 - 1e-14, xtol=1e-16)
    first, second = parts(m)
    return 1.0 - 2.0 * second / first, 1.0 - math.sqrt(2.0 * (2.0 * m - 1.0)) / first
