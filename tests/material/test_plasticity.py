"""J2 plasticity: derivatives, closed forms, objectivity, bodies against fibres and finite elements, history, ranks."""

import dataclasses
import importlib.util
import math

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.command_line.cli import arguments_of, load_case
from pdpetsc.solvers.newton import StaticSolver
from pdpetsc.solvers.protocol import StepResult
from tests.commands import ROOT, Stop, field, results, summary
from tests.scenes import DIMS, SCHEMES, body, dense_tangent, displacement, rotation

STEEL = pd.J2(E=100.0, nu=0.3, yield_stress=1.0, hardening=5.0)
STEP = 1e-6
BEAM = "runs/plasticity/beam.py"
PLATE = "runs/plasticity/plate.py"
beam_case = load_case(ROOT / BEAM)


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
    assert model.material_term.plastic_strain().max() > 0.005
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

    case = beam_case(ny=6, steps=2)
    for name, look_ahead in (("without", False), ("with", True)):
        calls.clear()
        monkeypatch.setattr(StaticSolver, "solve", failing(look_ahead))
        pd.run(case, output=tmp_path / name)
        assert calls == pytest.approx([0.5, 1.0, 0.75, 1.0])
    one, other = (field(tmp_path / name, "plastic_strain") for name in ("without", "with"))
    assert one.max() > 0.005
    assert np.abs(one - other).max() < 1e-12


def fibre_law():
    """Return the module of the law of fibres that the beam is held against."""
    spec = importlib.util.spec_from_file_location("moment", ROOT / "runs/plasticity/moment.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_moment_of_fibres_has_the_elastic_and_the_plastic_limit():
    moments = fibre_law().moments
    E, nu, y, height = 200e3, 0.3, 400.0, 10.0
    assert moments([1e-5], height, E, nu, y, 0.0)[0] == pytest.approx(E / (1 - nu**2) * height**3 / 12 * 1e-5, rel=1e-9)
    assert moments([0.05], height, E, nu, y, 0.0)[0] == pytest.approx(2 / math.sqrt(3) * y * height**2 / 4, rel=1e-4)


# Strain to which the patch is pulled and to which it goes back, and in how many steps.
TOP, BACK = 0.02, 0.018
PATCH_STEPS = 20


def patch_strain(t):
    return 2.0 * t * TOP if t <= 0.5 else TOP + (2.0 * t - 1.0) * (BACK - TOP)


def patch_force(dim, E=200e3, nu=0.3, y=400.0, H=2e3):
    """Return the nominal stress of a bar, a wide strip or a block after both strains, in logarithmic strain."""
    if dim == 2:
        fibre = fibre_law().Fibres(E, nu, y, H, 1)
        for step in range(1, PATCH_STEPS + 1):
            tau = fibre.stress(np.array([math.log1p(patch_strain(step / PATCH_STEPS))]))[0]
    else:
        tau = y + E * H / (E + H) * (math.log1p(TOP) - y / E) - E * (math.log1p(TOP) - math.log1p(BACK))
    return tau / (1.0 + BACK)


@pytest.mark.parametrize("dim", DIMS)
def test_a_patch_follows_the_law_of_its_fibres(dim, tmp_path):
    """Uniform stress along x, nothing across: what the free sides do in plastic flow is solved for."""
    sides = [20.0] + [4.0] * (dim - 1)
    pulled = pd.region.Slab("x", high=2.0) | pd.region.Slab("x", low=18.0)
    right = pd.region.Slab("x", low=18.0)

    # Layers of two horizons leave no family cut at the faces that are pulled; sides are free but for a rigid motion.
    free = [pd.Displacement(pd.region.Nearest([0.5] * dim), **{a: 0.0}) for a in "yz"[: dim - 1]]
    if dim == 3:
        free.append(pd.Displacement(pd.region.Nearest([0.5, 3.5, 0.5]), z=0.0))
    case = pd.Case(
        particles=pd.Lattice([0.0] * dim, sides, 1.0),
        horizon=1.015,
        material=pd.J2(E=200e3, nu=0.3, yield_stress=400.0, hardening=2e3),
        scheme=pd.SubHorizons(),
        conditions=[pd.Displacement(pulled, x=lambda x, t: patch_strain(t) * x[:, 0]), *free],
        steps=pd.Steps(PATCH_STEPS),
        history={"force": pd.Reaction("x", right)},
        results=lambda h: {"force": h["force"][-1]},
    )
    pd.run(case, output=tmp_path)
    found = summary(tmp_path)["results"]["force"]
    assert found == pytest.approx(patch_force(dim) * 4.0 ** (dim - 1), rel=1e-8)


@pytest.mark.long
def test_the_beam_in_bending_iterates_and_converges_to_the_moment_of_fibres(tmp_path):
    coarse, fine = (results(BEAM, f"ny={ny}", output=tmp_path / str(ny)) for ny in (5, 10))
    for name in ("error", "error_back"):
        assert coarse["results"][name] > 3.5 * fine["results"][name] > 0.0
    assert fine["results"]["error"] == pytest.approx(0.0696, rel=1e-2)
    assert fine["results"]["moment_back"] < 0.0
    assert all(2 <= step["newton_iterations"] <= 6 for step in fine["steps"][1:])
    results(BEAM, "ny=5", output=tmp_path / "two", ranks=2)
    for name in ("displacement", "plastic_strain"):
        one, two = (field(tmp_path / folder, name) for folder in ("5", "two"))
        assert np.abs(one - two).max() <= 1e-10 * np.abs(one).max()


@pytest.mark.long
def test_the_plate_is_near_finite_elements_and_nearer_with_one_gradient_per_particle(tmp_path):
    """Several gradients per particle are too many conditions for flow that keeps its volume."""
    found = {
        name: results(PLATE, *words, "steps=5", output=tmp_path)["results"]
        for name, words in (("sectors", ()), ("silling", ("scheme=correspondence", "control=silling")))
    }
    assert found["sectors"]["force_error"] == pytest.approx(0.0384, rel=2e-2)
    assert found["silling"]["force_error"] == pytest.approx(0.0246, rel=2e-2)
    for values in found.values():
        assert abs(values["mean_plastic_error"]) < 0.01
        assert values["stress_error"] < 0.065
        assert values["oscillation"] < 0.02


@pytest.mark.long
def test_higher_order_weights_calm_the_plate_at_the_horizon_that_makes_it_oscillate(tmp_path):
    found = {
        scheme: results(PLATE, f"scheme={scheme}", "horizon=2.015", "steps=3", output=tmp_path)["results"]
        for scheme in ("correspondence", "higher_order")
    }
    assert found["correspondence"]["oscillation"] > 3.0 * found["higher_order"]["oscillation"]
    assert found["correspondence"]["stress_error"] > 5.0 * found["higher_order"]["stress_error"]


@pytest.mark.long
@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("scheme", ["sub_horizons", "correspondence"])
def test_a_restart_goes_on_with_the_history_of_the_material(scheme, ranks, tmp_path):
    """Bent half of the way and on from there, on other ranks: the same plastic strain as without a stop."""
    words = ("ny=5", "steps=4", f"scheme={scheme}")
    results(BEAM, *words, output=tmp_path / "whole")
    case = beam_case(**arguments_of(beam_case, dict(word.split("=") for word in words)))
    stopped = dataclasses.replace(case, history={**case.history, "stop": Stop(0.4)})
    with pytest.raises(pd.Interrupted):
        pd.run(stopped, output=tmp_path / "half")
    results(BEAM, *words, "--restart-anyway", "--restart", tmp_path / "half", ranks=ranks, output=tmp_path / "again")
    for name in ("displacement", "plastic_strain"):
        whole, again = (field(tmp_path / run, name) for run in ("whole", "again"))
        assert np.abs(again - whole).max() <= 1e-10 * np.abs(whole).max(), name


@pytest.mark.parametrize(
    "wrong", [{"yield_stress": 0.0}, {"yield_stress": 1.0, "hardening": -1.0}, {"yield_stress": 1.0, "plane": "strip"}]
)
def test_wrong_constants_are_refused(wrong):
    with pytest.raises(pd.CaseError, match="J2"):
        pd.J2(E=1.0, nu=0.3, **wrong)


@pytest.mark.parametrize("control", [pd.Silling(), pd.TangentScaled(pd.Silling())])
def test_what_a_material_that_flows_dissipates_is_refused_at_the_start(control, tmp_path):
    """Its strain energy contains plastic work: of a bar that flows the difference would be next to nothing."""
    left, right = pd.region.Slab("x", high=1.0), pd.region.Slab("x", low=5.0)
    case = pd.Case(
        particles=pd.Lattice((0.0,), (6.0,), 1.0), horizon=1.015, scheme=pd.Correspondence(), control=control,
        material=pd.J2(E=100.0, nu=0.3, yield_stress=1.0, hardening=1.0),
        conditions=[pd.Displacement(left, x=0.0), pd.Displacement(right, x=0.2)], steps=pd.Steps(10),
        history={"work": pd.ExternalWork(), "stored": pd.StrainEnergy()},
    )  # fmt: skip
    history = pd.run(case, tmp_path / "stored").history
    # All but the elastic energy, sigma^2 / 2E over the free length, is lost; stored and lost are the work.
    assert history["work"][-1] > 0.1
    assert history["stored"][-1] == pytest.approx(history["work"][-1], rel=0.1)
    refused = dataclasses.replace(case, history={"lost": pd.DissipatedEnergy()})
    with pytest.raises(pd.CaseError, match="flows or relaxes"):
        pd.run(refused, tmp_path / "refused")
    assert not (tmp_path / "refused" / "summary.json").exists()
