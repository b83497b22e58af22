"""A force from outside the package: an elastic foundation, under every solver, on any ranks, restarted."""

import dataclasses

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import Stop, field, results

FOUNDATION = """
from dataclasses import dataclass

import numpy as np

import pdpetsc as pd


class Bed(pd.Term):
    energy_of = "foundation"

    def __init__(self, k):
        self.k = k

    @property
    def grounded(self):
        return np.repeat(self.k[:, None] > 0.0, 2, axis=1)

    def add_row_force(self, state, r):
        r[: len(self.k)] += self.k[:, None] * state.own

    def linearised(self, state):
        return pd.PointTangent(self.k[:, None, None] * np.eye(2))

    def energy(self, state):
        return 0.5 * float((self.k[:, None] * state.own**2).sum())


@dataclass(frozen=True)
class Foundation(pd.ExtraTerm):
    stiffness: float

    def build(self, body):
        return Bed(self.stiffness * body.cloud.volume[: body.cloud.n_owned])
"""
CASE = (
    FOUNDATION
    + """

def case(n=40, k=0.05, steps=2, solver="newton", stop=0.0, supports=True, material="linear"):
    # A strip pulled at its left end on a bed that holds it against that: E u'' = k u.
    dx = 20.0 / n
    left = pd.region.Slab("x", high=0.9 * dx)
    held = [pd.Displacement(left, x=-1e-3), pd.Displacement(pd.region.All(), y=0.0)]
    if solver == "path":
        held[0] = pd.Traction(left, x=-1e-3, normal=(-1.0, 0.0))
    solvers = {
        "newton": pd.Newton(),
        "path": pd.PathFollowing(
            pd.Opening("x", pd.region.Slab("x", low=20.0 - 0.9 * dx), against=left, step=2e-4, end=1e-3)
        ),
        "relaxation": pd.DynamicRelaxation(1e-9),
    }
    law = pd.LinearElastic(1.0, 0.0) if material == "linear" else pd.NeoHookean(1.0, 0.0)
    history = {"u": pd.At((0.5 * dx, 1.0), pd.displacement, "x"), "energy": pd.StrainEnergy()}
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (20.0, 2.0), dx),
        horizon=1.015 * dx,
        material=law,
        conditions=held if supports else [pd.BodyForce(pd.region.All(), y=-0.01)],
        steps=pd.Steps(steps),
        solver=solvers[solver],
        terms=[Foundation(k)],
        history=history,
        results=lambda h: {name: h[name][-1] for name in history},
        fields=[pd.displacement, pd.stress],
    )
"""
)


@pytest.fixture
def strip(tmp_path):
    path = tmp_path / "strip.py"
    path.write_text(CASE)
    return path


def axis(output):
    """Return the displacement along the strip where families are whole, over the first of them."""
    u = field(output, "displacement")[:, 0].reshape(-1, 4)[2:-2, 1]
    return u / u[0]


def exact(n, k=0.05, length=20.0):
    x = (np.arange(n) + 0.5)[2:-2] * length / n
    rate = np.sqrt(k)
    return np.cosh(rate * (length - x)) / np.cosh(rate * (length - x[0]))


@pytest.mark.parametrize("words", [(), ("-pd_jacobian", "matfree"), ("solver=path",), ("solver=relaxation",)])
@pytest.mark.parametrize("ranks", [1, 2])
def test_a_strip_on_a_foundation_decays_as_it_should(strip, words, ranks, tmp_path):
    results(strip, *words, ranks=ranks, output=tmp_path / "out")
    assert np.abs(axis(tmp_path / "out") - exact(40)).max() < 3e-3


def test_a_body_that_only_a_foundation_holds_sinks_evenly(strip, tmp_path):
    results(strip, "supports=false", "material=neo", output=tmp_path / "out")
    u = field(tmp_path / "out", "displacement")[:, :2]
    assert np.allclose(u, [0.0, -0.01 / 0.05], rtol=1e-9, atol=1e-10)


def test_without_a_foundation_that_body_is_refused(strip, tmp_path):
    with pytest.raises(pd.CaseError, match="rigid motions"):
        results(strip, "supports=false", "k=0.0", output=tmp_path / "out")


def test_a_run_on_a_foundation_goes_on_from_its_checkpoint(strip, tmp_path):
    words = ("material=neo", "steps=4")
    results(strip, *words, output=tmp_path / "whole")
    results(strip, *words, "steps=2", output=tmp_path / "half")
    results(strip, *words, "--restart", tmp_path / "whole", ranks=2, output=tmp_path / "again")
    one, two = (field(tmp_path / name, "displacement") for name in ("whole", "again"))
    assert np.abs(one - two).max() <= 1e-10 * np.abs(one).max()


def test_what_builds_no_term_is_refused():
    @dataclasses.dataclass(frozen=True)
    class Nothing(pd.ExtraTerm):
        stiffness: float = 1.0

        def build(self, body):
            return self.stiffness

    case = pd.Case(
        particles=pd.Lattice((0.0,), (1.0,), 0.1),
        horizon=0.1015,
        material=pd.LinearElastic(1.0),
        conditions=[pd.Displacement(pd.region.All(), x=0.0)],
        terms=[Nothing()],
        history={"stop": Stop(2.0)},
    )
    with pytest.raises(pd.CaseError, match="Nothing must build a Term"):
        pd.run(case, output="out/nothing", quiet=True)
