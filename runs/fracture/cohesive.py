"""Peak stresses of cohesive cracks in linear elastic bodies, which know no horizon: the references of the cracks here.

The stress across the crack falls linearly with its opening, from the strength to 0; ``length`` is ``E' Gc /
strength^2``. All is in units of the strength and of the modulus ``E'``, that of plane strain for the penny.
"""

import numpy as np

AT, WEIGHTS = (0.5 * one for one in np.polynomial.legendre.leggauss(40))
AT += 0.5


def over_griffith(body, a, length, cells=100):
    """Return the peak stress of a body with a crack of length ``a`` over the stress at which Griffith's crack runs.

    With the end of the cohesive zone at ``b > a`` the stress is finite there: ``K sigma = sum_i k_i p_i``. The stresses
    of the zone are ``p = 1 - delta / (2 length)`` with the opening ``delta = A sigma - g p``. The largest stress over
    all b is the peak. ``body(b, edges)`` returns ``K``, and for cells between ``edges``, the last of which is b, ``k``
    and ``A`` (cells,) and ``g`` (cells, cells).
    """
    peak = 0.0
    for b in a + length * np.geomspace(0.02, 6.0, 80):
        K, k, A, g = body(b, np.linspace(a, b, cells + 1))
        equations = np.zeros((cells + 1, cells + 1))
        equations[:cells, :cells] = np.eye(cells) - g / (2.0 * length)
        equations[:cells, cells] = A / (2.0 * length)
        equations[cells] = [*-k, K]
        stress = np.linalg.solve(equations, [*np.ones(cells), 0.0])[cells]
        if stress < peak:
            break
        peak = stress
    return peak * body(a, np.linspace(0.5 * a, a, 2))[0] / np.sqrt(length)


def centre(b, edges):
    """Return the coefficients of a crack of length 2 b in a plate (Tada, Paris, Irwin)."""
    x, size, share = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0], (np.arange(4) + 0.5) / 4.0
    X, S = np.sqrt(b**2 - x**2), np.sqrt(b**2 - (edges[:-1, None] + size * share) ** 2)
    logs = np.log(np.abs((X[:, None, None] + S) / (X[:, None, None] - S))).mean(axis=2)
    k = 2.0 * np.sqrt(b / np.pi) * np.diff(np.arcsin(np.minimum(edges / b, 1.0)))
    return np.sqrt(np.pi * b), k, 4.0 * X, 4.0 / np.pi * size * logs


def penny(b, edges):
    """Return the coefficients of a penny-shaped crack of radius b in a solid (Sneddon).

    Stresses s(r) open it by ``8 / (pi E') int_r^b dt / sqrt(t^2 - r^2) int_0^t s q dq / sqrt(t^2 - q^2)``; their stress
    intensity is ``2 / sqrt(pi b) int_0^b s q dq / sqrt(b^2 - q^2)``.
    """
    x = 0.5 * (edges[1:] + edges[:-1])
    X = np.sqrt(b**2 - x**2)
    t = np.sqrt(x[:, None] ** 2 + (X[:, None] * AT) ** 2)  # dt / sqrt(t^2 - x^2) = dv / t
    root = np.sqrt(np.maximum(t[:, :, None] ** 2 - edges**2, 0.0))
    g = 8.0 / np.pi * np.einsum("xv,xvi->xi", X[:, None] * WEIGHTS / t, root[:, :, :-1] - root[:, :, 1:])
    k = -2.0 / np.sqrt(np.pi * b) * np.diff(np.sqrt(b**2 - edges**2))
    return 2.0 * np.sqrt(b / np.pi), k, 8.0 / np.pi * X, g


def edge(width):
    """Return the body of a crack from the edge of a strip of a width, with a crack of up to half of it (Bueckner1970).

    Stresses s(x) on the faces of a crack of length c have the stress intensity ``K(c) = int_0^c s m(x, c) dx`` with
    ``m = sqrt(2 / (pi (c - x))) (1 + m_1 (1 - x / c) + m_2 (1 - x / c)^2)``, and open a crack of length b by
    ``2 / E' int_x^b m(x, c) K(c) dc`` (Rice1972).
    """

    def smooth(x, c):
        q, y = c / width, 1.0 - x / c
        return 1.0 + (0.6147 + 17.1844 * q**2 + 8.7822 * q**6) * y + (0.2502 + 3.2889 * q**2 + 70.0629 * q**6) * y**2

    def intensity(c, edges):
        """Return the stress intensities (n, cells) of unit stresses in cells, on cracks of lengths c (n,)."""
        low, high = np.minimum(edges[:-1], c[:, None]), np.minimum(edges[1:], c[:, None])
        roots = np.sqrt(c[:, None] - low) - np.sqrt(c[:, None] - high)
        return 2.0 * np.sqrt(2.0 / np.pi) * roots * smooth(0.5 * (low + high), c[:, None])

    def uniform(c):
        """Return the stress intensities (n,) of a unit stress: its cells are smaller towards the tip."""
        c = np.atleast_1d(c)
        x = c[:, None] * (1.0 - AT**2)  # dx / sqrt(c - x) = 2 sqrt(c) dv
        return 2.0 * np.sqrt(2.0 / np.pi * c) * (smooth(x, c[:, None]) @ WEIGHTS)

    def body(b, edges):
        x = 0.5 * (edges[1:] + edges[:-1])
        c = x[:, None] + (b - x[:, None]) * AT**2
        m = 4.0 * np.sqrt(2.0 / np.pi * (b - x[:, None])) * WEIGHTS * smooth(x[:, None], c)  # 2 m dc
        A = (m * uniform(c.ravel()).reshape(c.shape)).sum(axis=1)
        g = np.einsum("xv,xvi->xi", m, intensity(c.ravel(), edges).reshape(*c.shape, -1))
        return uniform(b)[0], intensity(np.array([b]), edges)[0], A, g

    return body
