"""Orders of convergence, extrapolated values and their error bars from results at several sizes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pdpetsc.errors import CaseError

# Relative differences of results below this are errors of the solver, not of the size [-], by default.
NOISE = 1e-6
# If orders of different sizes differ by more than this share, sizes are not in the asymptotic range [-].
APART = 0.25
# Roache's factors of safety on the estimated error: if other sizes confirm the order, and if there are none.
CONFIRMED, ALONE = 1.25, 3.0
# Largest order used for an error bar.
TRUSTED = 2.0
HIGHEST = 20.0
# Ends of the notes: what to do.
ADD = "add smaller sizes"
TIGHTEN = "use larger sizes or a tighter solver tolerance"


@dataclass(frozen=True)
class Convergence:
    """Convergence of one result under refinement of one parameter.

    Attributes
    ----------
    result : str
        Its name.
    group : mapping of str to str
        The other parameters.
    sizes, values : tuple of float
        Sizes and results, from the largest size to the smallest.
    order : float or None
        Observed order; None if there is none, with the reason in ``note``.
    orders : tuple of float
        Orders of three neighbouring sizes, or of two with an exact value.
    extrapolated : float or None
        Extrapolated limit of the result.
    error_bar : float or None
        Grid Convergence Index of the smallest size, in the unit of the result: the limit is expected within
        ``values[-1]`` plus and minus this.
    exact : float or None
        The exact value for the order, if declared.
    note : str
        Note for the user.
    """

    result: str
    sizes: tuple[float, ...]
    values: tuple[float, ...]
    group: Mapping[str, str] = field(default_factory=dict)
    order: float | None = None
    orders: tuple[float, ...] = ()
    extrapolated: float | None = None
    error_bar: float | None = None
    exact: float | None = None
    note: str = ""


def converging(
    result: str, sizes: Sequence[float], values: Sequence[float], exact: float | None = None,
    group: Mapping[str, str] | None = None, noise: float = NOISE,
) -> Convergence:  # fmt: skip
    """Compute the order of convergence of a result.

    ``f(h) = f_0 + C h^p`` is fitted to the three smallest sizes. The error bar of the smallest one is the Grid
    Convergence Index ``F_s |f_2 - f_1| / (r^p - 1)`` (Roache1998) with ``r = h_2 / h_1``, and ``p`` of at most 2:
    ``F_s`` is 1.25 if a fourth size confirms the order within a quarter, and 3 for three sizes. With an exact value
    ``p`` is the slope of the line of best fit to the logarithms of the errors of the three smallest sizes.

    Parameters
    ----------
    result : str
        Its name.
    sizes, values : sequences of float
        Positive sizes, in any order, and the result for each.
    exact : float, optional
        The exact limit, from another source.
    group : mapping, optional
        The other parameters.
    noise : float
        Relative error of a result by the tolerance of its solver.

    Returns
    -------
    Convergence
        Without an order, and with the reason in ``note``, if there are fewer than three sizes (two with an exact
        value), if the results do not approach a limit monotonically, if they differ only by the tolerance of solvers,
        or if the orders of different sizes differ: the sizes are then not small enough.

    Raises
    ------
    CaseError
        A size is not positive or occurs twice, or a value is not finite.

    Examples
    --------
    >>> sizes = [0.4, 0.2, 0.1, 0.05]
    >>> found = converging("u", sizes, [1.0 + 3.0 * h**2 for h in sizes])
    >>> round(found.order, 6), round(found.extrapolated, 6), round(found.error_bar, 6)
    (2.0, 1.0, 0.009375)
    """
    pairs = sorted(zip(map(float, sizes), map(float, values), strict=True), reverse=True)
    if any(not (size > 0.0 and math.isfinite(size)) for size, _ in pairs):
        raise CaseError(f"Sizes are positive numbers, not {', '.join(f'{size:g}' for size, _ in pairs)}.")
    if len({size for size, _ in pairs}) < len(pairs):
        raise CaseError(f"{result} is given twice for the same size.")
    if any(not math.isfinite(value) for _, value in pairs) or (exact is not None and not math.isfinite(exact)):
        raise CaseError(f"{result} is not finite at every size.")
    h, f = tuple(size for size, _ in pairs), tuple(value for _, value in pairs)
    found = Convergence(result, h, f, dict(group or {}), exact=exact)
    return _extrapolated(found, noise) if exact is None else _against(found, exact, noise)


def _against(found: Convergence, exact: float, noise: float) -> Convergence:
    """Return the convergence with its order against an exact value, or with a note why it has no order."""
    h, f = found.sizes, found.values
    if len(h) < 2:
        return replace(found, note=f"an order against an exact value needs two sizes, not {len(h)}")
    errors = [value - exact for value in f]
    scale = max(abs(exact), *map(abs, f))
    if min(map(abs, errors)) <= noise * scale:
        return replace(found, note=f"an error is below the solver tolerance; {TIGHTEN}")
    if min(errors) < 0.0 < max(errors):
        return replace(found, note=f"the error changes its sign; {ADD}")
    logs = np.log(np.array([h, [abs(error) for error in errors]]))
    steps = np.diff(logs)
    orders = tuple((steps[1] / steps[0]).tolist())
    if min(orders) <= 0.0:
        return replace(
            found, orders=orders, note=f"the error does not fall with the size; check the exact value, and {ADD}"
        )
    # Only the sizes used below: larger ones may not be small enough.
    slope = float(np.polyfit(logs[0, -3:], logs[1, -3:], 1)[0])
    if len(orders) == 1:
        note = "two sizes do not show whether they are small enough; add a third"
    elif _apart(orders[-2], orders[-1]):
        note = f"not in the asymptotic range, orders {_words(orders)}; {ADD}"
        return replace(found, orders=orders, note=note)
    elif any(_apart(order, orders[-1]) for order in orders[:-2]):
        note = f"the order of the three smallest sizes; the larger sizes have other orders: {_words(orders)}"
    else:
        note = ""
    return replace(found, order=slope, orders=orders, note=note)


def _extrapolated(found: Convergence, noise: float) -> Convergence:
    """Return the convergence with order, limit and error bar, or with the reason why there are none."""
    h, f = found.sizes, found.values
    if len(h) < 3:
        return replace(found, note=f"an order without an exact value needs three sizes, not {len(h)}")
    steps = [after - before for before, after in itertools.pairwise(f)]
    scale = max(map(abs, f))
    if min(map(abs, steps[-3:])) <= noise * scale:
        return replace(found, note=f"results of neighbouring sizes differ by less than the solver tolerance; {TIGHTEN}")
    if min(steps[-3:]) < 0.0 < max(steps[-3:]):
        return replace(found, note=f"the results are not monotone in the size; {ADD}")
    orders = tuple(
        order for k in range(max(0, len(h) - 4), len(h) - 2) if (order := _order(h[k : k + 3], steps[k : k + 2]))
    )
    if len(orders) < min(2, len(h) - 2):
        note = (
            f"the results do not approach a limit: their differences do not fall with the size; {ADD}, or refine the "
            f"horizon and the load steps along with it"
        )
        return replace(found, orders=orders, note=note)
    if len(orders) > 1 and _apart(*orders):
        return replace(found, orders=orders, note=f"not in the asymptotic range, orders {_words(orders)}; {ADD}")
    order, r = orders[-1], h[-2] / h[-1]
    safety = CONFIRMED if len(orders) > 1 else ALONE
    note = "" if len(orders) > 1 else "three sizes do not show whether they are small enough; add a fourth"
    return replace(
        found, order=order, orders=orders, extrapolated=f[-1] + steps[-1] / (r**order - 1.0),
        error_bar=safety * abs(steps[-1]) / (r ** min(order, TRUSTED) - 1.0), note=note,
    )  # fmt: skip


def _order(h: Sequence[float], steps: Sequence[float]) -> float | None:
    """Return p of ``f_0 + C h^p`` through three sizes from two differences; None if there is no p > 0."""
    asked = steps[0] / steps[1]

    def ratio(p: float) -> float:
        """Return the ratio of the first to the second difference, which grows with p."""
        a, b = h[0] / h[1], h[1] / h[2]
        return float((a**p - 1.0) / (1.0 - b**-p))

    from scipy.optimize import brentq

    low, high = 1e-6, HIGHEST
    if not ratio(low) < asked < ratio(high):
        return None
    return float(brentq(lambda p: ratio(p) - asked, low, high, xtol=1e-12))


def _apart(a: float, b: float) -> bool:
    return abs(a - b) > APART * max(abs(a), abs(b))


def _words(orders: Sequence[float]) -> str:
    return ", ".join(f"{order:.2f}" for order in orders)
