"""Products: what is applied without a matrix, the rows of a matrix, and its diagonal blocks are one linear map."""

import numpy as np
import pytest
from scipy.sparse import bsr_array

import pdpetsc as pd
from pdpetsc.discrete.sparsity import build_sparsity
from pdpetsc.gradient.base import Moduli
from pdpetsc.gradient.products import ConstraintProduct, Entries, PointProduct, RankOneProduct, SofteningProduct
from tests.scenes import DIMS, body


def dense(model, product):
    """Return the rows of a product on one process without images, dense."""
    whole, dim, n = model.problem.body.with_centres, model.dim, model.cloud.n_owned
    sparsity = build_sparsity(model.cloud, whole.point_ptr, whole.members)
    entries = Entries.zeros(sparsity)
    product.add_rows(entries)
    rows, values = sparsity.owned, np.empty((len(sparsity.owned.columns), dim, dim))
    for a, b in zip(rows.diag_ptr[:-1], rows.diag_ptr[1:], strict=True):
        values[a:b] = entries.diag[dim * dim * a : dim * dim * b].reshape(dim, b - a, dim).transpose(1, 0, 2)
    return bsr_array((values, rows.columns, rows.diag_ptr), shape=(n * dim, n * dim)).toarray()


def vectors(stencils, dim, rng):
    """Return random vectors of members that sum to zero in each stencil."""
    g = rng.standard_normal((len(stencils.members), dim))
    first = stencils.point_ptr[:-1]
    g[first] -= np.add.reduceat(g, first, axis=0)
    return g


def products(model, rng):
    """Return products of every kind over the families of a body."""
    stencils, n, dim = model.problem.body.with_centres, model.cloud.n_owned, model.dim
    h, g, b = vectors(stencils, dim, rng), vectors(stencils, dim, rng), rng.standard_normal(n)
    b[::3] = 0.0
    A = rng.standard_normal((model.operator.n_points, *(dim,) * 4))
    return {
        "rank one": RankOneProduct(stencils, n, h, g, b),
        "softening": SofteningProduct(stencils, n, h, g, b),
        "constraint": ConstraintProduct(stencils, n, h, np.abs(b), np.ones(n)),
        "points": PointProduct(model.operator, Moduli(A)),
        "control": model.control,
    }


@pytest.mark.parametrize("dim", DIMS)
def test_applied_and_assembled_products_are_the_same(dim, rng):
    model = body(dim, control=pd.Silling(0.5), rng=rng)
    n = model.cloud.n_owned
    for name, product in products(model, rng).items():
        K, du = dense(model, product), rng.standard_normal((n, dim))
        f = np.zeros_like(du)
        product.add_product(du, f, model.families.everyone)
        assert np.abs(f.ravel() - K @ du.ravel()).max() < 1e-12 * np.abs(f).max(), name
        blocks = np.zeros((n, dim, dim))
        assert product.add_point_blocks(blocks), name
        exact = np.array([K[dim * i : dim * (i + 1), dim * i : dim * (i + 1)] for i in range(n)])
        if name == "softening":  # counted by the secant of its bonds elsewhere
            assert not blocks.any()
        else:
            assert np.abs(blocks - exact).max() < 1e-12 * np.abs(exact).max(), name


def test_a_constraint_is_the_stiff_part_of_a_tangent(rng):
    """Without it the tangent is softened by ``D b (x) b``."""
    model = body(2, control=pd.Silling(0.5), rng=rng)
    kinds = products(model, rng)
    constraint = kinds["constraint"]
    assert constraint.constraint() is constraint
    assert all(product.constraint() is None for name, product in kinds.items() if name != "constraint")
    K = dense(model, constraint)
    assert np.abs(K - K.T).max() < 1e-13 * np.abs(K).max()
    assert np.linalg.eigvalsh(K)[0] > -1e-12 * np.abs(K).max()
