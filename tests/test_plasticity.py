"""J2 plasticity: derivatives, closed forms, objectivity, history that a cut-back leaves alone, ranks."""

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.cli import load_case
from pdpetsc.solve.base import StepResult
from pdpetsc.solve.static import StaticSolver
from tests.commands import ROOT, field, results, run
from tests.scenes import DIMS, SCHEMES, body, dense_tangent, displacement, rotation

STEEL = pd.J2(E=100.0, nu=0.3, yield_stress=1.0, hardening=5.0)
STEP = 1e-6
bar_case = load_case(ROOT / "runs/plasticity/bar.py")


class Point:
    """One material point with its history."""

    def __init__(self, dim, material=STEEL):
        self.dim, self.kernels, self.constants = dim, material.history_kernels(dim), material.constants(dim)
        self.history = material.initial_history(dim, 1)

    def _call(self, kernel, F, shape):
        out = np.empty((1, *shape))
        kernel(np.ascontiguousarray(F[None]), np.zeros(1, dtype=np.int64), self.constants, self.history, out)
        return out[0]

    def stress(self, F):
        return self._call(self.kernels.stress, F, (self.dim, self.dim))

    def tangent(self, F):
        return self._call(self.kernels.tangent, F, (self.dim,) * 4)

    def energy(self, F):
        return float(self._call(self.kernels.energy, F, ()))

    def commit(self, F):
        self.kernels.commit(np.ascontiguousarray(F[None]), np.zeros(1, dtype=np.int64), self.constants, self.history)


def path(dim, rng, steps=4, size=0.04):
    """Yield deformation gradients that wander well into the plastic range."""
    F = np.eye(dim)
    for _ in range(steps):
        F = F @ (np.eye(dim) + size * rng.standard_normal((dim, dim)))
        yield F


@pytest.mark.parametrize("dim", DIMS)
def test_stress_and_tangent_are_derivatives_at_every_point_of_a_path(dim, rng):
    point = Point(dim)
    for F in path(dim, rng):
        P, A = point.stress(F), point.tangent(F)
        for i in range(dim):
            for j in range(dim):
                d = np.zeros((dim, dim))
                d[i, j] = STEP
                slope = (point.energy(F + d) - point.energy(F - d)) / (2.0 * STEP)
                assert P[i, j] == pytest.approx(slope, abs=1e-7)
                column = (point.stress(F + d) - point.stress(F - d)) / (2.0 * STEP)
                assert np.abs(A[:, :, i, j] - column).max() < 1e-6 * np.abs(A).max()
        assert np.abs(A - A.transpose(2, 3, 0, 1)).max() < 1e-12 * np.abs(A).max()
        point.commit(F)
    assert point.history[0, -1] > 0.05


@pytest.mark.parametrize("dim", DIMS)
def test_a_committed_state_has_the_same_stress_and_lies_on_the_yield_surface(dim, rng):
    point = Point(dim)
    for F in path(dim, rng):
        before, energy = point.stress(F), point.energy(F)
        point.commit(F)
        assert np.allclose(point.stress(F), before, atol=1e-12)
        assert point.energy(F) == pytest.approx(energy, rel=1e-12)
    if dim == 3:
        tau = point.stress(F) @ F.T
        s = tau - np.trace(tau) / 3.0 * np.eye(3)
        assert np.sqrt(1.5 * (s * s).sum()) == pytest.approx(1.0 + 5.0 * point.history[0, -1], rel=1e-10)
        G = point.history[0, :9].reshape(3, 3)
        assert np.linalg.det(G) == pytest.approx(1.0, rel=1e-12)


def test_plane_strain_is_the_solid_without_strain_in_the_third_direction(rng):
    plane, solid = Point(2), Point(3)
    for F in path(2, rng):
        full = np.eye(3)
        full[:2, :2] = F
        assert np.allclose(plane.stress(F), solid.stress(full)[:2, :2], atol=1e-12)
        plane.commit(F)
        solid.commit(full)


def test_a_bar_follows_the_closed_form_through_loading_and_unloading():
    point, E, H = Point(1), 100.0, 5.0
    for strain in (0.005, 0.03):
        F = np.array([[np.exp(strain)]])
        tau = float(point.stress(F)[0, 0] * F[0, 0])
        assert tau == pytest.approx(
            E * strain if strain <= 0.01 else 1.0 + E * H / (E + H) * (strain - 0.01), rel=1e-12
        )
        point.commit(F)
    top = 1.0 + E * H / (E + H) * 0.02
    F = np.array([[np.exp(0.025)]])
    assert float(point.stress(F)[0, 0] * F[0, 0]) == pytest.approx(top - E * 0.005, rel=1e-12)


def test_below_the_yield_stress_it_is_hencky(rng):
    strong = pd.J2(E=100.0, nu=0.3, yield_stress=1e9)
    for dim in DIMS:
        F = next(path(dim, rng))
        elastic = pd.Hencky(E=100.0, nu=0.3)
        P, A = np.empty((1, dim, dim)), np.empty((1, dim, dim, dim, dim))
        elastic.kernels(dim).stress(F[None].copy(), np.zeros(1, np.int64), elastic.constants(dim), P)
        elastic.kernels(dim).tangent(F[None].copy(), np.zeros(1, np.int64), elastic.constants(dim), A)
        assert np.allclose(Point(dim, strong).stress(F), P[0], atol=1e-11)
        assert np.allclose(Point(dim, strong).tangent(F), A[0], atol=1e-9)


@pytest.mark.parametrize("dim", (2, 3))
def test_rotation_rotates_the_stress(dim, rng):
    point = Point(dim)
    for F in path(dim, rng, steps=3):
        Q = rotation(dim, rng)
        assert np.allclose(point.stress(Q @ F), Q @ point.stress(F), atol=1e-12)
        point.commit(Q @ F)


@pytest.mark.parametrize("scheme", ["correspondence", "sub_horizons", "bond_associated"])
@pytest.mark.parametrize("dim", DIMS)
def test_the_tangent_of_a_body_agrees_with_differences_after_plastic_flow(dim, scheme, rng):
    model = body(dim, SCHEMES[scheme], material=STEEL, rng=rng)
    model.commit(displacement(model, rng))
    assert model.matter.plastic_strain().max() > 0.005
    u = displacement(model, rng)
    K = dense_tangent(model, u)
    for column in range(0, u.size, 7):
        d = np.zeros(u.size)
        d[column] = STEP
        d = d.reshape(u.shape)
        difference = (model.internal_force(u + d) - model.internal_force(u - d)).ravel() / (2.0 * STEP)
        assert np.abs(K[:, column] - difference).max() < 2e-6 * np.abs(K).max()


def test_history_survives_a_cut_back(monkeypatch, tmp_path):
    """An attempt that evaluates states far along the path and then fails leaves the history as it was."""
    solve = StaticSolver.solve
    calls = []

    def failing(look_ahead):
        def attempt(self, u, t):
            calls.append(t)
            if len(calls) == 2:
                if look_ahead:
                    assert solve(self, u, t)[1].converged
                return u, StepResult(False, "made to fail")
            return solve(self, u, t)

        return attempt

    case = bar_case(dim=2, n=10, steps=2)
    for name, look_ahead in (("without", False), ("with", True)):
        calls.clear()
        monkeypatch.setattr(StaticSolver, "solve", failing(look_ahead))
        pd.run(case, output=tmp_path / name, quiet=True)
        assert calls == pytest.approx([0.5, 1.0, 0.75, 1.0])
    one, other = (field(tmp_path / name, "plastic_strain") for name in ("without", "with"))
    assert one.max() > 0.01
    assert np.abs(one - other).max() < 1e-12


def test_the_bar_follows_the_uniaxial_law_and_does_not_depend_on_ranks(tmp_path):
    found = results("runs/plasticity/bar.py", output=tmp_path / "one")
    assert found["results"]["force"] == pytest.approx(found["results"]["exact"], rel=1e-6)
    assert all(step["newton_iterations"] <= 6 for step in found["steps"])
    results("runs/plasticity/bar.py", output=tmp_path / "two", ranks=2)
    for name in ("displacement", "plastic_strain"):
        one, two = (field(tmp_path / folder, name) for folder in ("one", "two"))
        assert np.abs(one - two).max() <= 1e-10 * np.abs(one).max()


def test_the_plate_oscillates_less_with_higher_order_weights_and_least_with_sub_horizons(tmp_path):
    found = {}
    for scheme in ("correspondence", "higher_order", "sub_horizons"):
        arguments = (f"scheme={scheme}", "horizon=2.015", "steps=5")
        found[scheme] = results("runs/plasticity/plate.py", *arguments, output=tmp_path)["results"]
    assert found["sub_horizons"]["plastic_strain"] > 0.02
    assert found["correspondence"]["oscillation"] > 3.0 * found["higher_order"]["oscillation"]
    assert found["higher_order"]["oscillation"] > 2.0 * found["sub_horizons"]["oscillation"]


def test_restart_of_a_material_with_history_is_refused(tmp_path):
    results("runs/plasticity/bar.py", "steps=2", output=tmp_path)
    finished = run("runs/plasticity/bar.py", "--restart", tmp_path / "checkpoint.h5", output=tmp_path / "more")
    assert finished.returncode == 2
    assert "cannot be restarted" in finished.stderr


@pytest.mark.parametrize(
    "wrong", [{"yield_stress": 0.0}, {"yield_stress": 1.0, "hardening": -1.0}, {"yield_stress": 1.0, "plane": "stress"}]
)
def test_wrong_constants_are_refused(wrong):
    with pytest.raises(pd.CaseError, match="J2"):
        pd.J2(E=1.0, **wrong)
