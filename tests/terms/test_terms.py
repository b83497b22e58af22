"""A force from outside the package: an elastic foundation, under every solver, on any ranks, restarted."""

import dataclasses
import shutil

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.problem.extra import lie_in_families
from tests.commands import Stop, field, results
from tests.scenes import bodies

FOUNDATION = """
from dataclasses import dataclass

import numpy as np

import pdpetsc as pd
from pdpetsc.problem.extra import lie_in_families


class Bed(pd.Term):
    energy_of = "foundation"

    def __init__(self, k):
        self.k = k

    @property
    def grounded(self):
        return np.repeat(self.k[:, None] > 0.0, 2, axis=1)

    def add_row_force(self, state, r):
        r[: len(self.k)] += self.k[:, None] * state.own

    def linearise(self, state):
        return [pd.PointBlocks(self.k[:, None, None] * np.eye(2))]

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

def case(n=40, k=0.05, steps=2, solver="newton", supports=True, material="linear"):
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


SLIDERS = """
from dataclasses import dataclass

import numpy as np

import pdpetsc as pd
from pdpetsc.problem.extra import lie_in_families
from tests.commands import Stop


class Rub(pd.Term):
    # A spring from each particle to an anchor that slides where the spring is too long: friction.
    horizons = 0
    linear = False
    has_history = True
    energy_of = "friction"

    def __init__(self, k, reach):
        self.k, self.reach = k, reach
        self.anchor = np.zeros_like(k)

    def _pull(self, state):
        return np.clip(state.own[:, 0] - self.anchor, -self.reach, self.reach)

    def add_row_force(self, state, r):
        r[: len(self.k), 0] += self.k * self._pull(state)

    def linearise(self, state):
        blocks = np.zeros((len(self.k), 2, 2))
        blocks[:, 0, 0] = np.where(np.abs(state.own[:, 0] - self.anchor) < self.reach, self.k, 0.0)
        return [pd.PointBlocks(blocks)]

    def energy(self, state):
        return 0.5 * float((self.k * self._pull(state) ** 2).sum())

    def commit(self, state):
        self.anchor[:] = state.own[:, 0] - self._pull(state)
        self.version += 1

    def arrays(self):
        return {"anchor": pd.KeptArray(np.arange(len(self.k)), self.anchor)}


@dataclass(frozen=True)
class Friction(pd.ExtraTerm):
    stiffness: float = 0.05
    reach: float = 2e-4

    def build(self, body):
        return Rub(self.stiffness * body.cloud.volume[: body.cloud.n_owned], self.reach)


def case(n=20, stop=2.0):
    dx = 20.0 / n
    left = pd.region.Slab("x", high=0.9 * dx)
    history = {"energy": pd.StrainEnergy(), "dissipated": pd.DissipatedEnergy(), "work": pd.ExternalWork()}
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (20.0, 2.0), dx),
        horizon=1.015 * dx,
        material=pd.NeoHookean(1.0, 0.0),
        conditions=[
            pd.Displacement(left, x=1e-3, schedule=pd.Table((0.0, 0.4, 1.0), (0.0, 1.0, -0.5))),
            pd.Displacement(pd.region.All(), y=0.0),
        ],
        steps=pd.Steps(10),
        terms=[Friction()],
        history=history | {"stop": Stop(stop)},
        results=lambda h: {name: h[name][-1] for name in history},
        fields=[pd.displacement],
    )
"""


def test_a_term_with_history_goes_on_from_its_checkpoint_on_other_ranks(tmp_path):
    path = tmp_path / "rub.py"
    path.write_text(SLIDERS)
    whole = results(path, output=tmp_path / "whole")["results"]
    with pytest.raises(pd.Interrupted):
        results(path, "stop=0.5", output=tmp_path / "half")
    shutil.copytree(tmp_path / "half", tmp_path / "other")
    for ranks, name in ((1, "half"), (2, "other")):
        again = results(path, "--restart", tmp_path / name, ranks=ranks, output=tmp_path / name)["results"]
        one, two = (field(tmp_path / place, "displacement") for place in ("whole", name))
        assert np.abs(one - two).max() <= 1e-10 * np.abs(one).max()
        assert again["dissipated"] == pytest.approx(whole["dissipated"], rel=1e-8)
    assert whole["dissipated"] > 0.1 * whole["work"] > 0.0


class Odd(pd.Term):
    """A bed with whatever is wrong with it."""

    def __init__(self, k, of):
        self.k, self.of, self.load = k, of, of == "load"
        self.symmetric = of != "unsymmetric"
        self.horizons = {"far": 3, "apart": 1}.get(of, 0)

    def add_row_force(self, state, r):
        offset = 0.01 if self.of == "offset" else 0.0
        r[: len(self.k)] += self.k[:, None] * (state.own + offset) * (state.t if self.of == "time" else 1.0)

    def linearise(self, state):
        time = state.t if self.of == "time" else 1.0
        return [pd.PointBlocks(self.k[:, None, None] * np.array([[1.0, self.of == "unsymmetric"], [0.0, 1.0]]) * time)]

    @property
    def stencils(self):
        if self.of != "apart":
            return None
        return np.array([0, 2], dtype=np.int64), np.array([0, len(self.k) - 1], dtype=np.int32)

    def arrays(self):
        values = np.full(len(self.k), np.nan if self.of == "nan" else 0.0)
        if self.of != "copy":
            values = self.__dict__.setdefault("values", values)
        return {"values": pd.KeptArray(np.arange(len(self.k)), values)} if self.of in ("copy", "nan") else {}


class Forgetful(Odd):
    """A term whose force nobody asks for."""

    def add_force(self, state, f):
        f[: len(self.k)] += self.k[:, None] * state.own


@dataclasses.dataclass(frozen=True)
class OddBed(pd.ExtraTerm):
    of: str = ""

    def build(self, body):
        make = Forgetful if self.of == "forgetful" else Odd
        return make(0.05 * body.cloud.volume[: body.cloud.n_owned], self.of)


def strip_on(of, solver):
    left, right = pd.region.Slab("x", high=0.9), pd.region.Slab("x", low=9.1)
    solvers = {
        "newton": pd.Newton(),
        "path": pd.PathFollowing(pd.Opening("x", right, against=left, step=1e-3, end=2e-3)),
        "events": pd.EventDriven(),
    }
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (10.0, 2.0), 1.0),
        horizon=1.015,
        material=pd.BondBased(1.0),
        conditions=[
            pd.Displacement(left, x=0.0),
            pd.Displacement(pd.region.All(), y=0.0),
            pd.Force(right, x=1e-3),
        ],
        solver=solvers[solver],
        terms=[OddBed(of)],
    )


@pytest.mark.parametrize("solver", ["path", "events"])
@pytest.mark.parametrize(
    ("of", "words"),
    [
        ("load", "Odd has a tangent"),
        ("offset", "those of Odd do not"),
        ("time", "those of Odd do not"),
    ],
)
def test_what_does_not_scale_with_the_load_factor_is_refused(solver, of, words, tmp_path):
    with pytest.raises(pd.CaseError, match=words):
        pd.run(strip_on(of, solver), tmp_path / "out")
    pd.run(strip_on("", solver), tmp_path / "out")


def test_events_need_a_symmetric_tangent(tmp_path):
    with pytest.raises(pd.CaseError, match="needs a symmetric tangent, and that of Odd is not"):
        pd.run(strip_on("unsymmetric", "events"), tmp_path / "out")


@pytest.mark.parametrize(
    ("of", "words"),
    [
        ("forgetful", "gives add_force, but couples particles over no horizon"),
        ("far", "over 3 horizons"),
        ("apart", "in no common family"),
        ("copy", "values of the term of OddBed is a copy"),
    ],
)
def test_a_term_whose_forces_or_arrays_would_be_lost_is_refused(of, words, tmp_path):
    with pytest.raises(pd.CaseError, match=words):
        pd.run(strip_on(of, "newton"), tmp_path / "out")


def test_arrays_of_terms_have_the_name_of_their_term():
    """Whatever other terms there are: a number tells terms of one class apart."""
    case = strip_on("nan", "newton")
    for terms, names in (
        ([], []),
        ([OddBed("nan")], ["Odd.values"]),
        (2 * [OddBed("nan")], ["Odd.values", "Odd#2.values"]),
    ):
        for more in ([], [OddBed()]):
            problem = pd.prepare(dataclasses.replace(case, terms=[*terms, *more])).problem
            assert list(problem.arrays()) == names


def test_an_array_that_is_no_number_never_replaces_a_checkpoint(tmp_path):
    with pytest.raises(pd.OutputError, match="is not a number"):
        pd.run(strip_on("nan", "newton"), tmp_path / "out")


@pytest.mark.parametrize(
    ("owner", "values"), [([1, 0], np.zeros(2)), ([0], np.zeros(2)), ([0, 1], np.zeros(2, dtype=np.float32))]
)
def test_an_array_to_keep_that_makes_no_sense_is_refused(owner, values):
    with pytest.raises(pd.CaseError, match="KeptArray"):
        pd.KeptArray(np.array(owner), values)


def test_what_builds_no_term_is_refused():
    @dataclasses.dataclass(frozen=True)
    class Nothing(pd.ExtraTerm):
        stiffness: float = 1.0

        def build(self, body):
            return self.stiffness

    case = pd.Case(
        particles=pd.Lattice((0.0,), (1.0,), 0.1),
        horizon=0.1015,
        material=pd.LinearElastic(1.0, nu=0.0),
        conditions=[pd.Displacement(pd.region.All(), x=0.0)],
        terms=[Nothing()],
        history={"stop": Stop(2.0)},
    )
    with pytest.raises(pd.CaseError, match="Nothing must build a Term"):
        pd.run(case, output="out/nothing")


def test_stencils_of_families_and_bonds_are_known_as_such(rng):
    for name, small in bodies(rng):
        stencils = small.problem.material_term.stencils
        assert lie_in_families(small.problem.body, *stencils), name
        if "smoothed" in name:  # one family is the whole body
            continue
        ptr, members = stencils
        # The first stencil gets a member of the other end of the body.
        far = np.concatenate([[small.problem.body.cloud.n_owned - 1], members]).astype(np.int32)
        assert not lie_in_families(small.problem.body, np.concatenate([[0], ptr[1:] + 1]), far), name
