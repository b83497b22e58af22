"""Inertia, contact with a rigid tool and a pressure that follows the surface, as terms from outside the package."""

from dataclasses import dataclass

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.gradient.base import StencilMembers
from pdpetsc.gradient.products import RankOneProduct
from tests.commands import script_on


@dataclass(frozen=True)
class Inertia(pd.ExtraTerm):
    """``M a`` by Newmark's average acceleration; load parameter 1 is the time ``duration``."""

    density: float
    duration: float

    def build(self, body):
        return InertiaTerm(body, self.density, self.duration)


class InertiaTerm(pd.Term):
    linear = False  # its tangent depends on the length of the step
    energy_of = "kinetic"

    def __init__(self, body, density, duration):
        self.n, self.duration = body.cloud.n_owned, duration
        self.mass = density * body.cloud.volume[: self.n, None]
        # Displacement, velocity, acceleration and load parameter of the last converged step.
        self.last = np.zeros((self.n, 3 * body.dim + 1))

    def motion(self, state):
        dim = state.own.shape[1]
        u, v, a = (self.last[:, k * dim : (k + 1) * dim] for k in range(3))
        dt = self.duration * (state.t - (self.last[0, -1] if self.n else 0.0))
        if dt == 0.0:  # the state that has been committed
            return v, a, dt
        new = 4.0 * (state.own - u - dt * v) / dt**2 - a
        return v + 0.5 * dt * (a + new), new, dt

    def add_row_force(self, state, r):
        r[: self.n] += self.mass * self.motion(state)[1]

    def linearise(self, state):
        dt = self.motion(state)[2]
        return [pd.PointBlocks(4.0 / dt**2 * self.mass[:, :, None] * np.eye(state.own.shape[1]))]

    def energy(self, state):
        return float(0.5 * (self.mass * self.motion(state)[0] ** 2).sum())

    def commit(self, state):
        v, a, _ = self.motion(state)
        self.last[:] = np.hstack([state.own, v, a, np.full((self.n, 1), state.t)])
        self.version += 1

    has_history = True

    def arrays(self):
        return {"motion": pd.KeptArray(np.arange(self.n, dtype=np.int32), self.last)}


def struck(steps=40, **given):
    """Return a clamped strip whose end is pulled and let go."""
    declared = {
        "particles": pd.Lattice((0.0, 0.0), (8.0, 3.0), 1.0), "horizon": 2.015, "material": pd.LinearElastic(10.0, 0.3),
        "scheme": pd.Correspondence(), "control": pd.Silling(0.5),
        "conditions": [
            pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0, y=0.0),
            pd.Force(pd.region.Slab("x", low=7.0), x=0.3, y=0.1, schedule=lambda t: min(4.0 * t, 1.0)),
        ],
        "terms": [Inertia(1.0, 20.0)], "steps": pd.Steps(steps), "fields": [],
    }  # fmt: skip
    return pd.Case(**{**declared, **given})


def test_newmark_from_outside_is_that_of_dense_matrices(tmp_path):
    result = pd.run(struck(), output=tmp_path / "whole")
    problem, u = result.solution.problem, result.solution.u
    term = next(term for term in problem.terms if isinstance(term, InertiaTerm))
    bare = pd.prepare(struck(terms=[])).problem
    size = u.size
    K = np.array([bare.linearised(bare.state(0.0 * u))(e.reshape(u.shape)).ravel().copy() for e in np.eye(size)])
    free = ~problem.supports.fixed.ravel()
    K, M = K[np.ix_(free, free)], np.repeat(term.mass, 2, axis=1).ravel()[free]
    load = problem.external_force(problem.state(u, 1.0)).ravel()[free]
    dt, q, v, a = 0.5, *np.zeros((3, free.sum()))
    for step in range(1, 41):
        f = min(4.0 * step / 40.0, 1.0) * load
        new = np.linalg.solve(K + np.diag(4.0 * M / dt**2), f + M * (4.0 / dt**2 * (q + dt * v) + a))
        next_a = 4.0 * (new - q - dt * v) / dt**2 - a
        q, v, a = new, v + 0.5 * dt * (a + next_a), next_a
    assert np.abs(u.ravel()[free] - q).max() < 1e-8 * np.abs(q).max()
    assert np.abs(v).max() > 0.01
    energies = problem.energies(result.solution.state)
    assert sum(energies.values()) == pytest.approx(result.solution.work, rel=1e-8)
    assert energies["kinetic"] > 0.01 * energies["strain"]


@dataclass(frozen=True)
class RigidPlane(pd.ExtraTerm):
    """A frictionless plane that comes down from ``height`` by ``depth``, with a penalty stiffness per area."""

    height: float
    depth: float
    stiffness: float

    def build(self, body):
        return PlaneContact(body, self)


class PlaneContact(pd.Term):
    linear = False

    def __init__(self, body, plane):
        self.n, self.plane = body.cloud.n_owned, plane
        x = body.cloud.x[: self.n]
        # The outer layer has half a spacing of material above its particles.
        self.height = x[:, 1] + 0.5
        self.k = plane.stiffness * (self.height > plane.height - 0.5)

    def gap(self, state):
        plane = self.plane.height - self.plane.depth * state.t
        return plane - self.height - state.own[:, 1]

    def pressure(self, state):
        return -self.k * np.minimum(self.gap(state), 0.0)

    def add_row_force(self, state, r):
        r[: self.n, 1] += self.pressure(state)

    def linearise(self, state):
        blocks = np.zeros((self.n, 2, 2))
        blocks[:, 1, 1] = self.k * (self.gap(state) < 0.0)
        return [pd.PointBlocks(blocks)]

    def energy(self, state):
        return float(0.5 * (self.k * np.minimum(self.gap(state), 0.0) ** 2).sum())

    def numbers(self):
        return {"contact": lambda state: self.pressure(state).sum()}

    def fields(self):
        return {"contact_pressure": self.pressure}


def pressed(**given):
    """Return a block with a slanted top that a plane presses down."""
    declared = {
        "particles": pd.Lattice(
            (0.0, 0.0), (8.0, 6.0), 1.0,
            cut=pd.region.Where(lambda x: x[:, 1] > 4.0 + (x[:, 0] > 3.0) + (x[:, 0] > 5.0)),
        ),
        "horizon": 2.015, "material": pd.Hencky(10.0, 0.3), "scheme": pd.Correspondence(), "control": pd.Silling(0.5),
        "conditions": [pd.Displacement(pd.region.Slab("y", high=1.0), x=0.0, y=0.0)],
        "terms": [RigidPlane(6.0, 1.5, 200.0)], "steps": pd.Steps(6), "fields": [pd.displacement],
        "history": {"held": pd.Reaction("y", pd.region.Slab("y", high=1.0))},
    }  # fmt: skip
    return pd.Case(**{**declared, **given})


def test_a_rigid_plane_from_outside_presses_as_much_as_is_held(tmp_path):
    result = pd.run(pressed(), output=tmp_path)
    contact, held = (np.array(result.history[name]) for name in ("contact", "held"))
    assert contact[-1] > 5.0 and np.all(np.diff(contact) > 0.0)
    assert np.abs(contact - held).max() < 1e-7 * contact[-1]
    assert np.sum(result.field("contact_pressure")) == pytest.approx(contact[-1], rel=1e-9)
    touched = result.solution.x[:, 1] + 0.5 + result.solution.u[:, 1] > 4.5
    # Other steps come into contact as it goes down, and none of them stands above the plane by more than the penalty.
    assert touched.sum() > 3
    assert max(step["newton_iterations"] for step in result.summary["steps"]) <= 8


@dataclass(frozen=True)
class FollowerPressure(pd.ExtraTerm):
    """A pressure on the deformed surface of a plane body, by Nanson's formula with the gradient of each facet."""

    pressure: float
    on_surface = True

    def build(self, body):
        return PressureTerm(body, self.pressure)


class PressureTerm(pd.Term):
    linear, symmetric, load, horizons = False, False, True, 2

    def __init__(self, body, pressure):
        surface, cloud = body.surface, body.cloud
        self.n_owned, self.pressure = cloud.n_owned, pressure
        order = np.argsort(surface.owner, kind="stable")
        sizes = np.diff(surface.ptr)[order]
        entries = np.concatenate([np.arange(surface.ptr[f], surface.ptr[f + 1]) for f in order] or [[]]).astype(int)
        self.ptr = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        self.members, self.N = surface.members[entries], surface.N[entries]
        self.facet = np.repeat(np.arange(len(sizes)), sizes)
        self.area, self.owner = surface.area[order], surface.owner[order]
        # Weights of the gradient that fits the members of a facet best.
        x = cloud.x[self.members]
        middle = np.stack([np.bincount(self.facet, x[:, a], len(sizes)) for a in (0, 1)], axis=1) / sizes[:, None]
        xi = x - middle[self.facet]
        M = np.zeros((len(sizes), 2, 2))
        np.add.at(M, self.facet, xi[:, :, None] * xi[:, None, :])
        self.g = np.einsum("emn,en->em", np.linalg.inv(M)[self.facet], xi)

    @property
    def stencils(self):
        return self.ptr, self.members

    def add_force(self, state, f):
        F = np.tile(np.eye(2), (len(self.area), 1, 1))
        np.add.at(F, self.facet, state.u_local[self.members][:, :, None] * self.g[:, None, :])
        (a, b), (c, d) = np.moveaxis(F, 0, 2)
        cofactor = np.moveaxis(np.array([[d, -c], [-b, a]]), 2, 0)
        force = self.pressure * state.t * np.einsum("fij,fj->fi", cofactor, self.area)
        np.add.at(f, self.members, self.N[:, None] * force[self.facet])

    def linearise(self, state):
        stencils = StencilMembers(self.owner.astype(np.int32), self.ptr, self.members)
        A, p, products = self.area, self.pressure * state.t, []
        # Component of the force, and of the displacement gradient that changes it, with the area that multiplies it.
        parts = (0, 1, 1, A[:, 0]), (0, 1, 0, -A[:, 1]), (1, 0, 1, -A[:, 0]), (1, 0, 0, A[:, 1])
        for force, moved, gradient, by in parts:
            h, g = np.zeros((2, len(self.members), 2))
            h[:, force], g[:, moved] = self.N, self.g[:, gradient]
            products.append(RankOneProduct(stencils, self.n_owned, h, g, p * by))
        return products


def squeezed(**given):
    """Return a block under a pressure that follows its surface all round."""
    corner = pd.region.Nearest((0.0, 0.0))
    declared = {
        "particles": pd.LatticeNodes((0.0, 0.0), (6.0, 4.0), 1.0), "horizon": 2.015, "material": pd.Hencky(10.0, 0.3),
        "conditions": [
            pd.Displacement(corner, x=0.0, y=0.0), pd.Displacement(pd.region.Nearest((6.0, 0.0)), y=0.0)
        ],
        "terms": [FollowerPressure(3.0)], "steps": pd.Steps(4), "fields": [pd.displacement],
    }  # fmt: skip
    return pd.Case(**{**declared, **given})


def test_a_follower_pressure_from_outside_makes_a_uniform_cauchy_stress(tmp_path):
    result = pd.run(squeezed(), output=tmp_path)
    sigma = pd.stress(result.solution)
    assert np.abs(sigma[:, :2, :2] + 3.0 * np.eye(2)).max() < 1e-8
    assert np.abs(result.solution.u).max() > 0.5
    assert max(step["newton_iterations"] for step in result.summary["steps"]) <= 6


PRESSED = """
import sys
import numpy as np
import pdpetsc as pd
from tests.terms.test_outside import pressed, squeezed, struck
case = {"pressed": pressed, "squeezed": squeezed, "struck": struck}[sys.argv[1]](fields=[pd.displacement])
u = pd.run(case, output=sys.argv[2]).gathered(pd.displacement)
if u is not None:
    np.save(sys.argv[3], u)
"""


@pytest.mark.parametrize("name", ["pressed", "squeezed", "struck"])
def test_two_ranks_find_the_same(name, tmp_path):
    for ranks in (1, 2):
        script_on(ranks, PRESSED, name, tmp_path / f"run{ranks}", tmp_path / f"u{ranks}.npy")
    one, two = (np.load(tmp_path / f"u{ranks}.npy") for ranks in (1, 2))
    assert np.abs(one - two).max() < 1e-8 * np.abs(one).max()


class Slider(pd.ExtraTerm):
    """Springs to the ground that slide at a force of 0.05: they dissipate that force times the way they slid."""

    k, most = 20.0, 0.05

    def build(self, body):
        return SliderTerm(body)


class SliderTerm(pd.Term):
    linear = False
    has_history = True
    energy_of = "slider"

    def __init__(self, body):
        self.n, self.dim = body.cloud.n_owned, body.dim
        self.slid = np.zeros((self.n, body.dim))

    def force(self, u):
        return np.clip(Slider.k * (u - self.slid), -Slider.most, Slider.most)

    def add_row_force(self, state, r):
        r[: self.n] += self.force(state.own)

    def linearise(self, state):
        k = np.where(np.abs(self.force(state.own)) < Slider.most, Slider.k, 1e-9)
        return [pd.PointBlocks(k[:, :, None] * np.eye(self.dim))]

    def energy(self, state):
        return float((self.force(state.own) ** 2).sum() / (2.0 * Slider.k))

    def commit(self, state):
        self.slid[:] = state.own - self.force(state.own) / Slider.k
        self.version += 1

    def arrays(self):
        return {"slid": pd.KeptArray(np.arange(self.n, dtype=np.int32), self.slid)}


def test_what_a_term_of_ones_own_dissipates_counts_beside_bonds_that_may_fail(tmp_path):
    low, high = pd.region.Slab("x", high=1.0), pd.region.Slab("x", low=11.0)
    case = pd.Case(
        particles=pd.Arrays(np.arange(12.0)[:, None] + 0.5, 1.0, thickness=1.0),
        horizon=1.1,
        material=pd.BondBased(E=100.0),
        damage=pd.LinearSoftening(pd.ConstantCritical(0.05), 4.0),
        conditions=[pd.Displacement(low, x=0.0), pd.Displacement(high, x=0.4)],
        terms=[Slider()],
        steps=pd.Steps(80),
        history={"dissipated": pd.DissipatedEnergy()},
        fields=[],
    )
    result = pd.run(case, output=tmp_path)
    # All springs slide away from where they began, and never back.
    slid = np.maximum(np.abs(result.solution.u) - Slider.most / Slider.k, 0.0)
    assert result.history["dissipated"][-1] == pytest.approx(Slider.most * np.abs(slid).sum(), rel=0.02)
    assert np.abs(slid).sum() > 1.0
