"""Mirror planes: halves, quarters and eighths are the whole body, for every model and solver, on any rank count."""

import itertools

import numpy as np
import pytest
from scipy.spatial import cKDTree

import pdpetsc as pd
from pdpetsc.gradient import stress_points
from tests.commands import ROOT, field, jacobian_ratios, results, run
from tests.scenes import ALL_CONTROLS, BONDS

TOP = {1: (5.0,), 2: (4.0, 5.0), 3: (3.0, 3.0, 4.0)}
ELASTIC = pd.Hencky(E=10.0, nu=0.3)


def pulled(planes, whole, dim=2, pull=0.4, **changes):
    """Return a block, the part before its mirror planes or the whole of it, pulled on the middle of its upper end.

    The pull is along an axis without a plane where there is one; else the whole block is pulled on both ends.
    """
    letters = "xyz"[:dim]
    high = np.array(TOP[dim])
    low = np.array([-top if whole and letter in planes else 0.0 for letter, top in zip(letters, high, strict=True)])
    axis = next((letter for letter in reversed(letters) if letter not in planes), letters[-1])
    along = letters.index(axis)
    middle = {letter: 0.0 for letter in letters if letter != axis}

    def end(first, last):
        corners = np.stack([-0.6 * high, 0.6 * high])
        corners[:, along] = first, last
        return pd.region.Box(*corners)

    conditions = [pd.Displacement(end(high[along] - 1.0, high[along]), **middle, **{axis: pull})]
    if axis not in planes:
        conditions.append(pd.Displacement(end(0.0, 1.0), **middle, **{axis: 0.0}))
    elif whole:
        conditions.append(pd.Displacement(end(low[along], low[along] + 1.0), **middle, **{axis: -pull}))
    declared = {
        "particles": pd.Lattice(low, high, 1.0),
        "horizon": 2.015,
        "material": ELASTIC,
        "conditions": conditions,
        "symmetry": () if whole else tuple(pd.Symmetry(letter) for letter in planes),
    }
    return pd.Case(**(declared | changes))


def solved(case, options=None):
    """Return positions, fields and energies of the last state of a case, on this process."""
    prepared = pd.prepare(case, options=options)
    solver = prepared.make_solver()
    try:
        *_, last = prepared.march(solver)
        solution = prepared.solution(last.u, last.t)
        fields = {f.__name__: f(solution).copy() for f in (pd.displacement, pd.stress, pd.lost_bonds)}
        return solution.x.copy(), fields, {**solution.energies, "broken": solution.broken_bonds}, last.t
    finally:
        solver.destroy()


def assert_the_part_is_the_whole(part, whole, options=None, tolerance=1e-10):
    """Compare the last states of both; return what was found of the whole."""
    x, fields, energies, t = solved(part, options)
    x_whole, fields_whole, energies_whole, t_whole = solved(whole, options)
    apart, place = cKDTree(x_whole).query(x)
    assert apart.max() < 1e-9
    assert t == pytest.approx(t_whole, rel=tolerance)
    for name, values in fields_whole.items():
        assert np.abs(fields[name] - values[place]).max() <= tolerance * np.abs(values).max(), name
    images = len(x_whole) // len(x)
    for name in ("strain", "control"):
        assert images * energies[name] == pytest.approx(energies_whole[name], rel=10.0 * tolerance)
    return fields_whole, energies_whole


def both(planes, options=None, tolerance=1e-10, **changes):
    """Compare a part of the block with the whole."""
    part, whole = (pulled(planes, whole, **changes) for whole in (False, True))
    return assert_the_part_is_the_whole(part, whole, options, tolerance)


@pytest.mark.parametrize(("dim", "planes"), [(1, "x"), (2, "x"), (2, "y"), (2, "xy"), (3, "y"), (3, "xz"), (3, "xyz")])
def test_a_part_is_the_whole(dim, planes):
    both(planes, dim=dim)


@pytest.mark.parametrize("scheme", [name for name in pd.SCHEMES if name != "stress_points"])
def test_a_part_is_the_whole_with_every_scheme(scheme):
    both("xy", scheme=pd.SCHEMES[scheme], horizon=3.015 if scheme in ("corrected", "higher_order") else 2.015)


def test_a_part_is_the_whole_with_stress_points_drawn_alike(monkeypatch):
    """The draws of a whole body have no symmetry of their own: they are made symmetric here."""
    drawn = stress_points._drawn
    part, whole = (pulled("xy", whole, scheme=pd.StressPoints()) for whole in (False, True))
    x_part, x_whole = (case.particles.chunk(0, 1).x for case in (part, whole))
    home = cKDTree(x_part).query(np.abs(x_whole))[1]
    turned = ((x_whole[:, 0] < 0.0) ^ (x_whole[:, 1] < 0.0)).astype(np.uint64)

    def symmetric(gid, seed):
        return drawn(home[gid], seed) ^ turned[gid] if len(gid) == len(x_whole) else drawn(gid, seed)

    monkeypatch.setattr(stress_points, "_drawn", symmetric)
    assert_the_part_is_the_whole(part, whole)


@pytest.mark.parametrize("control", [name for name in ALL_CONTROLS if name != "none"])
@pytest.mark.parametrize("material", ["hencky", "linear"])
def test_a_part_is_the_whole_with_every_control(control, material):
    chosen = ELASTIC if material == "hencky" else pd.LinearElastic(E=10.0, nu=0.3)
    _, energies = both("xy", scheme=pd.Correspondence(), control=ALL_CONTROLS[control], material=chosen)
    assert energies["control"] > 0.0


@pytest.mark.parametrize("planes", ["x", "xy"])
@pytest.mark.parametrize("bonds", BONDS)
def test_a_part_is_the_whole_with_every_material_of_bonds(bonds, planes):
    both(planes, material=BONDS[bonds])


def test_plasticity_and_grading_are_those_of_the_whole():
    graded = pd.Graded(pd.J2(E=10.0, nu=0.3, yield_stress=0.3, hardening=1.0), lambda x: 1.0 + 0.1 * x[:, 1] ** 2)
    both("xy", material=graded, steps=pd.Steps(2))


@pytest.mark.parametrize("dim", [2, 3])
def test_without_a_matrix_and_by_relaxation_a_part_is_the_whole(dim):
    planes = "xyz"[:dim]
    both(planes, {"pd_jacobian": "matfree", "ksp_rtol": 1e-12}, dim=dim)
    if dim == 2:
        both(planes, {"pc_type": "gamg", "ksp_rtol": 1e-12}, control=pd.Silling(0.1))
        both(planes, tolerance=1e-8, solver=pd.DynamicRelaxation(1e-12))
