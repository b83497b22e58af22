"""Lattices with broken bonds: shared weights of steps give what listed weights give."""

import dataclasses
import tracemalloc

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.control.base import Stiffness
from pdpetsc.declare import region
from pdpetsc.discrete.communicator import world
from pdpetsc.gradient.base import ControlledGradient, Moduli
from pdpetsc.gradient.broken_lattice import BrokenLatticeGradient, RowSprings
from pdpetsc.running.build import make_cloud, make_families, make_problem


def boxes(size, spacing):
    """Return particles of a lattice whose cells are no cubes."""
    axes = [(np.arange(round(length / step)) + 0.5) * step for length, step in zip(size, spacing, strict=True)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(size))
    return pd.Arrays(x, np.full(len(x), float(np.prod(spacing))))


SCENES = {
    "plane": {"particles": boxes((24.0, 20.0), (1.0, 0.8)), "horizon": 2.015},
    "solid": {"particles": boxes((14.0, 12.0, 13.2), (1.0, 0.8, 1.1)), "horizon": 2.015},
    "bar": {"particles": pd.Lattice(0.0, 60.0, 1.0), "horizon": 3.015},
    "periodic": {
        "particles": pd.Lattice((0.0, 0.0), (24.0, 20.0), 1.0), "horizon": 2.015,
        "cell": pd.Cell((0.0, 0.0), (24.0, 20.0), "xy"),
    },
    "mirrored": {
        "particles": pd.Lattice((0.0, 0.0), (24.0, 20.0), 1.0), "horizon": 2.015, "symmetry": [pd.Symmetry("x")],
    },
    "cracked": {
        "particles": pd.Lattice((0.0, 0.0), (30.0, 24.0), 1.0), "horizon": 3.015,
        "cracks": [pd.Segment((0.0, 12.0), (15.0, 12.0))],
    },
}  # fmt: skip


def operators(name, lost=0.05):
    """Return a cloud, its families, the weights of bonds, and the operators with shared and with listed weights."""
    case = pd.Case(
        material=pd.LinearElastic(E=1.0, nu=0.3),
        damage=pd.Brittle(pd.ConstantCritical(1.0)),
        conditions=[pd.Displacement(region.All(), x=0.0)],
        **SCENES[name],
    )
    cloud = make_cloud(world(), case)
    families = make_families(case, cloud)
    omega = np.where(np.random.default_rng(2).random(families.n_bonds) < lost, 0.0, 1.0)
    listed = dataclasses.replace(families, grid=None)
    shared, plain = (pd.Correspondence().build(cloud, one, omega) for one in (families, listed))
    assert isinstance(shared, BrokenLatticeGradient) and not isinstance(plain, BrokenLatticeGradient)
    return cloud, families, omega, shared, plain


def silling(cloud, families, kappa):
    """Return the control of intact families with moduli ``kappa`` (n_owned,)."""
    moduli = pd.LinearElastic(E=1.0, nu=0.3).moduli(cloud.dim)[None]
    stiffness = Stiffness(kappa, moduli, np.zeros(len(kappa), dtype=np.int32), np.ones(len(kappa)))
    return pd.Silling(0.5).build(cloud, families, np.ones(families.n_bonds), stiffness)


@pytest.mark.parametrize("name", SCENES)
def test_shared_weights_are_the_listed_ones(name):
    cloud, families, omega, shared, plain = operators(name)
    rng, dim, n = np.random.default_rng(3), cloud.dim, cloud.n_owned
    size = np.abs(plain.g).max()
    for attribute in ("point_ptr", "members", "owner", "points_of", "volume"):
        assert np.array_equal(getattr(shared, attribute), getattr(plain, attribute)), attribute
    assert np.abs(shared.g - plain.g).max() <= 1e-13 * size
    some = np.flatnonzero(rng.random(n) < 0.3)
    assert np.abs(shared.at(some).g - plain.at(some).g).max() <= 1e-13 * size
    u = rng.uniform(-1.0, 1.0, (cloud.n_local, dim))
    H = plain.gradient(u)
    assert np.abs(shared.gradient(u) - H).max() <= 1e-13 * np.abs(H).max()
    stiffness = Stiffness(
        rng.uniform(1.0, 2.0, n),
        pd.LinearElastic(E=1.0, nu=0.3).moduli(dim)[None],
        np.zeros(n, dtype=np.int32),
        np.ones(n),
    )
    control = pd.Silling(0.5).build(cloud, dataclasses.replace(families), np.ones(len(omega)), stiffness).damaged(omega)
    P, A = rng.uniform(-1.0, 1.0, (n, dim, dim)), rng.uniform(-1.0, 1.0, (n, *(dim,) * 4))
    sets, of = A[:5], rng.integers(0, 5, n).astype(np.int32)
    for moduli in (Moduli(A), Moduli(sets, of)):
        for controlled in (False, True):
            forces = []
            for operator in (shared, plain):
                same, loop, f = control.of_gradient(operator), operator.loop(moduli), np.zeros_like(u)
                if controlled:
                    loop = loop.controlled(same)
                    operator.divergence(P, f, ControlledGradient(same, H, u))
                else:
                    operator.divergence(P, f)
                inside = np.arange(n, dtype=np.int32)
                for part in (inside[::2].copy(), inside[1::2].copy()):
                    loop.add(u, f, part)
                forces.append(f)
            assert np.abs(forces[0] - forces[1]).max() <= 1e-12 * np.abs(forces[1]).max()
        blocks = [np.zeros((cloud.n_local, dim, dim)) for _ in range(2)]
        for operator, found in zip((shared, plain), blocks, strict=True):
            operator.loop(moduli).add_point_blocks(found)
        assert np.abs(blocks[0] - blocks[1]).max() <= 1e-12 * np.abs(blocks[1]).max()


def test_families_with_another_stiffness_of_the_control_have_their_own_loop():
    """A control that lacks other bonds than the gradient: those of a particle without gradient, for example."""
    cloud, families, omega, shared, plain = operators("plane")
    n = cloud.n_owned
    kept = omega.copy()
    kept[families.indptr[40] : families.indptr[41] : 2] = 0.0
    control = silling(cloud, families, np.ones(n)).damaged(kept)
    same = control.of_gradient(shared)
    assert isinstance(same, RowSprings) and np.array_equal(np.flatnonzero(same.apart), [40])
    assert control.of_gradient(plain) is None
    u, A = np.random.default_rng(4).uniform(-1.0, 1.0, (cloud.n_local, 2)), Moduli(np.ones((n, 2, 2, 2, 2)))
    everyone, together, apart = families.everyone, np.zeros_like(u), np.zeros_like(u)
    shared.loop(A).controlled(same).add(u, together, everyone)
    plain.loop(A).add(u, apart, everyone)
    control.force(u, apart, everyone)
    assert np.abs(together - apart).max() <= 1e-12 * np.abs(apart).max()


def test_few_rows_and_unequal_volumes_list_their_weights():
    """Thin bodies lack most members of a family; nodes on a surface have smaller volumes."""
    thin = pd.Lattice((0.0, 0.0), (40.0, 2.0), 1.0)
    nodes = pd.LatticeNodes((0.0, 0.0), (20.0, 20.0), 1.0)
    for particles in (thin, nodes):
        case = pd.Case(
            particles=particles, horizon=2.015, material=pd.LinearElastic(E=1.0, nu=0.3),
            damage=pd.Brittle(pd.ConstantCritical(1.0)), conditions=[pd.Displacement(region.All(), x=0.0)],
        )  # fmt: skip
        cloud = make_cloud(world(), case)
        families = make_families(case, cloud)
        assert families.grid is not None
        built = pd.Correspondence().build(cloud, families, np.ones(families.n_bonds))
        assert not isinstance(built, BrokenLatticeGradient)


def test_a_control_of_damaged_bonds_has_the_stiffness_that_is_left():
    """Bonds of one particle are lost, of another all but those along x, and of others some of their stiffness."""
    case = pd.Case(
        material=pd.LinearElastic(E=1.0, nu=0.3), damage=pd.Brittle(pd.ConstantCritical(1.0)),
        conditions=[pd.Displacement(region.All(), x=0.0)], **SCENES["plane"],
    )  # fmt: skip
    cloud = make_cloud(world(), case)
    families = make_families(case, cloud)
    rng, n = np.random.default_rng(5), cloud.n_owned
    control, xi = silling(cloud, families, rng.uniform(1.0, 2.0, n)), families.bonds(cloud.x)
    phi = np.where(rng.random(families.n_bonds) < 0.1, rng.uniform(0.0, 1.0, families.n_bonds), 1.0)
    lone, flat = (slice(*families.indptr[i : i + 2]) for i in (150, 200))
    phi[lone], phi[flat] = 0.0, np.abs(xi[flat, 1]) < 1e-9
    s = control.bond_stiffness * phi
    damaged = control.damaged(phi)
    assert np.array_equal(control.damaged(np.ones(len(phi))).bond_stiffness, control.bond_stiffness)
    assert np.allclose(damaged.bond_stiffness, s, rtol=1e-15, atol=0.0)
    K = np.zeros((n, 2, 2))
    np.add.at(K, families.centres, s[:, None, None] * xi[:, :, None] * xi[:, None, :])
    expected = np.linalg.pinv(K, rcond=1e-6, hermitian=True)
    assert not expected[150].any() and np.linalg.matrix_rank(expected[200]) == 1
    assert np.allclose(damaged.K_inverse, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    u = rng.uniform(-1.0, 1.0, (cloud.n_local, 2))
    energy = damaged.energy(u, families.everyone)
    assert energy == pytest.approx(damaged.family_energy(u).sum(), rel=1e-14)
    assert energy == pytest.approx(damaged.force(u, np.zeros_like(u), families.everyone), rel=1e-14)


def test_broken_bonds_take_little_memory():
    """At the peak of the set-up 60 bytes a bond: its ends, its degradation factor, and three numbers for a while."""
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0, 0.0), (18.0, 18.0, 18.0), 1.0), horizon=3.015,
        material=pd.LinearElastic(E=1.0, nu=0.3), scheme=pd.Correspondence(), control=pd.Silling(0.5),
        weights=pd.Standard(), damage=pd.Brittle(pd.ConstantCritical(1.0)),
        conditions=[pd.Displacement(region.Slab("x", high=1.0), x=0.0, y=0.0, z=0.0)],
    )  # fmt: skip

    def peak():
        tracemalloc.start()
        try:
            cloud = make_cloud(world(), case)
            families = make_families(case, cloud)
            problem = make_problem(case, cloud, families)
            problem.damage.bonds.phi[np.random.default_rng(6).random(families.n_bonds) < 0.02] = 0.0
            problem.bonds_restored()
            tangent = problem.linearised(problem.state(np.zeros((cloud.n_rows, 3))))
            tangent.point_blocks()
            tangent.stiffness()
            return tracemalloc.get_traced_memory()[1] / families.n_bonds
        finally:
            tracemalloc.stop()

    peak()  # compiles
    assert peak() < 60.0
