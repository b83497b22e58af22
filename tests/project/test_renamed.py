"""Old public names warn and go on for one release."""

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc import damage


@pytest.mark.parametrize(
    ("module", "old", "new"),
    [(pd, old, new) for old, new in pd._RENAMED.items()] + [(damage, old, new) for old, new in damage._RENAMED.items()],
)
def test_old_names_warn(module, old, new):
    with pytest.warns(FutureWarning, match=new):
        assert getattr(module, old) is getattr(module, new)


def test_methods_of_a_class_of_ones_own_may_have_their_old_names():
    with pytest.warns(FutureWarning, match="phi"):

        class Old(damage.BondDamage):
            def integrity(self, x):
                return np.ones_like(x)

    assert Old.phi is Old.integrity
    with pytest.warns(FutureWarning, match="is_nonlocal"):

        class Mean(damage.DrivingVariable):
            reaches = True

    assert Mean.is_nonlocal is True


def test_a_term_may_return_its_tangent_by_the_old_name():
    with pytest.warns(FutureWarning, match="linearise"):

        class Bed(pd.Term):
            def __init__(self, product):
                self.product = product

            def linearised(self, state):
                return self.product

    product = pd.PointBlocks(np.ones((1, 2, 2)))
    assert Bed(product).linearise(None) == [product]
    assert Bed(None).linearise(None) == []
