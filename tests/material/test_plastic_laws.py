"""Laws with history at points: derivatives, objectivity, closed forms, free sides, time, and small bodies."""

import dataclasses

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.command_line.cli import load_case
from pdpetsc.material.at_points import MaterialAtPoints
from tests.commands import ROOT, field, results, summary
from tests.laws import DURATION, ISOTROPIC, LAWS, NU, E, Y
from tests.scenes import body, dense_tangent, differences, displacement, rotation

hard, rates = pd.hardening, pd.rate
CASE = "tests/laws.py"
TIMED = [name for name, law in LAWS.items() if getattr(law, "rate", None)]
BODIES = {"bar": (1, "strain"), "strain": (2, "strain"), "stress": (2, "stress"), "solid": (3, "strain")}
STEP = 1e-6
N = 8
everywhere = pytest.mark.parametrize(("name", "kind"), [(name, kind) for name in LAWS for kind in BODIES])


class Points:
    """A law at some points, with the load parameter of now and of the last converged step."""

    def __init__(self, material, dim, n=N):
        self.material, self.dim = material, dim
        self.of = MaterialAtPoints(material, np.arange(n), dim, None)
        self.t = self.converged = 0.0

    @property
    def at(self):
        return self.of.at((self.material.duration or 0.0) * (self.t - self.converged))

    def _of(self, method, F, *shape):
        out = np.empty((len(F), *shape))
        method(np.ascontiguousarray(F), out)
        return out

    def stress(self, F):
        return self._of(self.at.stress, F, self.dim, self.dim)

    def tangent(self, F):
        return self._of(self.at.tangent, F, *(self.dim,) * 4)

    def energy(self, F):
        return self._of(self.at.energy, F)

    def commit(self, F):
        self.at.commit(np.ascontiguousarray(F))
        self.converged = self.t

    @property
    def alpha(self):
        return self.at.plastic_strain()


def points_of(name, kind, n=N):
    dim, plane = BODIES[kind]
    return Points(dataclasses.replace(LAWS[name], plane=plane), dim, n)


def wander(points, rng, steps=3, size=0.06):
    """Yield deformation gradients on a path: loaded, loaded further, and back in part, so that some points unload."""
    n, dim = len(points.at.points), points.dim
    F = back = np.tile(np.eye(dim), (n, 1, 1))
    for step in range(steps):
        before, H = F, size * rng.standard_normal((n, dim, dim))
        # Half the points go back a part of their way on the last step and are elastic there; the others flow on.
        F = F @ (np.eye(dim) + H)
        if step == steps - 1:
            F[: n // 2] = back[: n // 2]
        back = before + 0.7 * (F - before)
        points.t += 0.2
        yield F


def derivative(function, F, dim):
    columns = np.empty((*function(F).shape, dim, dim))
    for i in range(dim):
        for j in range(dim):
            d = np.zeros((dim, dim))
            d[i, j] = STEP
            columns[..., i, j] = (function(F + d) - function(F - d)) / (2.0 * STEP)
    return columns


@everywhere
def test_stress_and_tangent_are_derivatives_in_elastic_plastic_and_reversed_states(name, kind, rng):
    points = points_of(name, kind)
    for F in wander(points, rng):
        P, A = points.stress(F), points.tangent(F)
        assert np.abs(A - derivative(points.stress, F, points.dim)).max() < 1e-7 * np.abs(A).max()
        if points.material.symmetric:
            assert np.abs(P - derivative(points.energy, F, points.dim)).max() < 1e-7 * E
            assert np.abs(A - A.transpose(0, 3, 4, 1, 2)).max() < 1e-11 * np.abs(A).max()
        before, energy = points.alpha.copy(), points.energy(F)
        points.commit(F)
        # What has been taken is the same state: stress and energy do not change when the step ends.
        assert np.allclose(points.stress(F), P, atol=1e-11 * E)
        assert np.allclose(points.energy(F), energy, atol=1e-12 * E)
    if name in ("maxwell", "own"):  # without a yield stress nothing is elastic
        return
    grown = points.alpha - before
    assert grown.max() > 0.01 and (grown == 0.0).any()


@pytest.mark.parametrize("kind", ["strain", "stress", "solid"])
@pytest.mark.parametrize("name", LAWS)
def test_a_rotation_turns_the_stress(name, kind, rng):
    points = points_of(name, kind)
    for F in wander(points, rng):
        Q = rotation(points.dim, rng)
        assert np.allclose(points.stress(Q @ F), Q @ points.stress(F), atol=1e-11 * E)
        points.commit(Q @ F)


@everywhere
def test_free_sides_of_a_solid_are_plane_stress_and_a_bar(name, kind, rng):
    """The solid, whose lateral stretches are taken from the law, has no stress there and the same one elsewhere."""
    points = points_of(name, kind)
    dim, solid = points.dim, Points(dataclasses.replace(LAWS[name], plane="strain"), 3)
    for F in wander(points, rng):
        solid.t = points.t
        P = points.stress(F)
        full = np.tile(np.eye(3), (len(F), 1, 1))
        full[:, :dim, :dim] = F
        # In the running step they are already what they are once it is committed.
        running = points.at.hidden_stretch(F), points.at.out_of_plane_stress(F)
        points.commit(F)
        hidden = points.at.hidden_stretch(F)
        assert np.allclose(running[0], hidden, rtol=1e-9)
        assert np.allclose(running[1], points.at.out_of_plane_stress(F), atol=1e-9 * E)
        for a in range(dim, 3):
            full[:, a, a] = hidden if kind in ("strain", "stress") else np.sqrt(hidden)
        found = solid.stress(full)
        assert np.allclose(found[:, :dim, :dim], P, atol=1e-10 * E)
        if kind in ("bar", "stress"):
            assert np.abs(found[:, 2, 2]).max() < 1e-10 * E
        if kind == "strain":
            assert np.allclose(points.at.out_of_plane_stress(F), found[:, 2, 2], atol=1e-10 * E)
        solid.commit(full)
        assert np.allclose(solid.alpha, points.alpha, atol=1e-11)


@pytest.mark.parametrize("name", ISOTROPIC)
def test_a_bar_hardens_as_declared_through_reversal(name):
    """``tau = y + R(alpha)`` while it flows, at ``alpha = |strain| - tau / E``, and the same after the load turns."""
    points, law = points_of(name, "bar", 1), ISOTROPIC[name]
    for strain in np.linspace(0.0, 0.3, 7)[1:]:
        F = np.array([[[np.exp(strain)]]])
        tau = float(points.stress(F)[0, 0, 0] * F[0, 0, 0])
        points.commit(F)
        assert points.alpha[0] == pytest.approx(strain - tau / E, rel=1e-12)
        assert tau == pytest.approx(Y + float(law.increase(points.alpha)[0]), rel=1e-12)
    # Elastic from tau to -tau, then flow on the other side.
    top = tau
    back = strain - 1.5 * top / E
    F = np.array([[[np.exp(back)]]])
    assert float(points.stress(F)[0, 0, 0] * F[0, 0, 0]) == pytest.approx(-0.5 * top, rel=1e-10)
    F = np.array([[[np.exp(strain - 0.3)]]])
    tau, before = float(points.stress(F)[0, 0, 0] * F[0, 0, 0]), points.alpha[0]
    points.commit(F)
    assert points.alpha[0] == pytest.approx(before + 0.3 - (top - tau) / E, rel=1e-12)
    assert tau == pytest.approx(-Y - float(law.increase(points.alpha)[0]), rel=1e-12)


def test_a_bar_yields_early_after_the_load_has_turned():
    """Prager: yield at ``X - y`` with the centre ``X = kinematic alpha`` of the way forth, no isotropic hardening."""
    points = Points(pd.KinematicJ2(E, NU, yield_stress=Y, kinematic=0.8), 1, 1)
    stress = []
    strains = (*np.linspace(0.01, 0.2, 20), *np.linspace(0.199, 0.0, 200))
    for strain in strains:
        F = np.array([[[np.exp(strain)]]])
        stress.append(float(points.stress(F)[0, 0, 0] * F[0, 0, 0]))
        before = points.alpha[0]
        points.commit(F)
        if strain == strains[19]:
            plastic, top = points.alpha[0], stress[-1]
    hardening = E * 0.8 / (E + 0.8)
    assert top == pytest.approx(Y + hardening * (0.2 - Y / E), rel=1e-12)
    assert plastic == pytest.approx(0.2 - top / E, rel=1e-12)
    # Back by 2 y it is elastic, then hardens at the same slope.
    assert stress[-1] == pytest.approx(top - 2.0 * Y - hardening * (0.2 - 2.0 * Y / E), rel=1e-9)
    assert points.alpha[0] > before


def test_without_a_back_stress_the_additive_law_is_the_other_one_where_axes_stay():
    """``J2`` and ``KinematicJ2`` agree on stretches along fixed axes."""
    both = [Points(LAWS["voce"], 3, 1)]
    both.append(Points(pd.KinematicJ2(E, NU, yield_stress=Y, hardening=ISOTROPIC["voce"]), 3, 1))
    for s in np.linspace(0.0, 1.0, 6)[1:]:
        F = np.diag([1.0 + 0.2 * s, 1.0 - 0.12 * s, 1.0 + 0.03 * s])[None]
        P = [points.stress(F) for points in both]
        assert np.allclose(*P, rtol=1e-11, atol=1e-12 * E)
        for points in both:
            points.commit(F)


def test_the_law_of_the_page_creeps_in_closed_form():
    """A bar held at a strain relaxes as ``1 / q^(n - 1) = 1 / q_0^(n - 1) + (n - 1) E rate_0 t / q_0^n``."""
    points = Points(LAWS["own"], 1, 1)
    F = np.array([[[np.exp(0.05)]]])
    steps = 500
    for step in range(1, steps + 1):
        points.t = step / steps
        points.commit(F)
    tau = float(points.stress(F)[0, 0, 0] * F[0, 0, 0])
    assert tau == pytest.approx(((0.05 * E) ** -2.0 + 2.0 * E * 0.2 * DURATION / 0.5**3) ** -0.5, rel=3e-2)


@pytest.mark.parametrize("steps", [1, 7])
def test_a_held_shear_relaxes_in_closed_form_in_steps_of_any_size(steps):
    """``T = 2 mu e + sum_k 2 shear_k e exp(-t / times_k)`` after a sudden shear, at finite strain."""
    law = LAWS["maxwell"]
    points = Points(law, 3, 1)
    F = np.eye(3)[None].copy()
    F[0, 0, 1] = 0.6
    points.commit(F)
    start = points.stress(F)
    for step in range(1, steps + 1):
        points.t = 0.7 * step / steps
        P = points.stress(F)
        points.commit(F)
    mu, _ = law.shear_and_bulk
    stiff = mu + sum(g * np.exp(-0.7 * DURATION / t) for g, t in zip(law.shear, law.times, strict=True))
    # E has no trace in simple shear, so that all of P has the factor of the deviator.
    assert np.allclose(P, start * stiff / (mu + sum(law.shear)), rtol=1e-11, atol=1e-13)


def test_fast_and_slow_loading_have_their_moduli():
    law, F = LAWS["maxwell"], np.eye(3)[None] + 1e-6 * np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    for duration, shear in ((1e-9, E / 2.6 + 4.0), (1e9, E / 2.6)):
        points = Points(dataclasses.replace(law, duration=duration), 3, 1)
        points.t = 1.0
        assert points.stress(F)[0, 0, 1] == pytest.approx(2e-6 * shear, rel=1e-5)


@pytest.mark.parametrize("law", ISOTROPIC.values(), ids=ISOTROPIC)
def test_a_hardening_law_agrees_with_its_slope_and_integral(law):
    alpha = np.array([1e-3, 0.013, 0.05, 0.11, 0.4, 0.7])
    h = 1e-6
    assert np.allclose((law.increase(alpha + h) - law.increase(alpha - h)) / (2 * h), law.slope(alpha), rtol=1e-6)
    assert np.allclose((law.integral(alpha + h) - law.integral(alpha - h)) / (2 * h), law.increase(alpha), rtol=1e-6)
    assert law.increase(np.zeros(1))[0] == law.integral(np.zeros(1))[0] == 0.0


def test_simple_shear_of_a_solid_flows_at_the_yield_stress_and_turns_round():
    """``sqrt(3) tau_12`` is near ``y + R(alpha)`` at small shear, forth and back; Kirchhoff's obeys it."""
    points = points_of("voce", "solid", 1)

    def yielded():
        return Y + float(ISOTROPIC["voce"].increase(points.alpha)[0])

    for shear in (*np.linspace(0.02, 0.2, 10), *np.linspace(0.19, -0.2, 40)):
        F = np.eye(3)[None].copy()
        F[0, 0, 1] = shear
        before = points.alpha[0]
        tau = (points.stress(F) @ F.transpose(0, 2, 1))[0]
        points.commit(F)
        s = tau - np.trace(tau) / 3.0 * np.eye(3)
        q = np.sqrt(1.5 * (s * s).sum())
        assert q == pytest.approx(yielded(), rel=1e-11) if points.alpha[0] > before else q < yielded()
        if shear in (0.2, -0.2):
            assert abs(tau[0, 1]) * np.sqrt(3.0) == pytest.approx(yielded(), rel=5e-2)
            assert np.sign(tau[0, 1]) == np.sign(shear)


def test_overstress_of_a_linear_viscosity_relaxes_as_an_exponential():
    """A bar is pulled at once and held: ``q - y`` falls as ``exp(-t / T)``, ``1 / T = E rate_0 / drag``."""
    rate = rates.Perzyna(duration=1.0, rate_0=2.0, drag=5.0)
    points = Points(pd.J2(E, NU, yield_stress=Y, rate=rate), 1, 1)
    F = np.array([[[np.exp(0.1)]]])
    points.t = 1e-12
    points.commit(F)
    steps, T = 200, 5.0 / (E * 2.0)
    for step in range(1, steps + 1):
        points.t = 0.5 * step / steps
        points.commit(F)
    tau = float(points.stress(F)[0, 0, 0] * F[0, 0, 0])
    assert tau - Y == pytest.approx((E * 0.1 - Y) * (1.0 + 0.5 / steps / T) ** -steps, rel=1e-9)
    assert tau - Y == pytest.approx((E * 0.1 - Y) * np.exp(-0.5 / T), rel=2e-2)


def test_johnson_and_cook_at_a_steady_rate_and_heat():
    """``q = (A + B alpha^n) (1 + C ln(rate / rate_0)) (1 - T*^m)`` of a bar that is pulled at a steady rate."""
    law, points = LAWS["johnson_cook"], points_of("johnson_cook", "bar", 1)
    heat = 1.0 - 0.2**1.1
    for step in range(1, 51):
        points.t = 0.02 * step
        F = np.array([[[np.exp(0.4 * points.t)]]])
        tau = float(points.stress(F)[0, 0, 0] * F[0, 0, 0])
        before = points.alpha[0]
        points.commit(F)
    rate = (points.alpha[0] - before) / (0.02 * DURATION)
    slow = Y + float(law.hardening.increase(points.alpha)[0])
    assert points.alpha[0] == pytest.approx(0.4 - tau / E, rel=1e-12)
    assert rate == pytest.approx(0.4 / DURATION, rel=0.1)
    assert tau == pytest.approx(slow * (1.0 + 0.1 * np.log(rate / 0.02)) * heat, rel=1e-10)


def strengths(material):
    """Return the Kirchhoff stress at which a bar yields in tension and in compression."""
    found = []
    for sign in (1.0, -1.0):
        points = Points(material, 1, 1)
        for strain in np.linspace(0.0, 0.3 * sign, 31)[1:]:
            F = np.array([[[np.exp(strain)]]])
            assert points.at.defined(F)
            points.commit(F)
        found.append(float(abs(points.stress(F)[0, 0, 0] * F[0, 0, 0])))
    return found


def test_a_cone_has_the_strength_of_mohr_and_coulomb():
    """``2 c cos(phi) / (1 -+ sin(phi))`` in compression and tension, each by its fit; the cohesion does not harden."""
    phi, c = 0.5, 0.15
    sin, cos = np.sin(phi), np.cos(phi)
    soil = pd.DruckerPrager(E, NU, cohesion=c, friction=phi)
    assert strengths(soil)[1] == pytest.approx(2.0 * c * cos / (1.0 - sin), rel=1e-12)
    assert strengths(dataclasses.replace(soil, fit="tension"))[0] == pytest.approx(2 * c * cos / (1 + sin), rel=1e-12)
    for dilatancy in (None, 0.1, 0.0):
        other = dataclasses.replace(soil, dilatancy=dilatancy, fit="plane strain")
        eta, _, xi = other.cone
        found = strengths(other)
        assert found[0] * (1.0 / np.sqrt(3.0) + eta / 3.0) == pytest.approx(xi * c, rel=1e-12)
        assert found[1] * (1.0 / np.sqrt(3.0) - eta / 3.0) == pytest.approx(xi * c, rel=1e-12)
    # Associated flow in plane strain: (s1 - s2) / 2 = c cos(phi) - (s1 + s2) / 2 sin(phi), dilating by sin(phi).
    points = Points(dataclasses.replace(soil, fit="plane strain"), 2, 1)
    for strain in np.linspace(0.0, 0.4, 41)[1:]:
        F = np.diag(np.exp([strain, -strain * (1.0 - sin) / (1.0 + sin)]))[None]
        tau = np.linalg.eigvalsh((points.stress(F) @ F.transpose(0, 2, 1))[0])
        points.commit(F)
    assert (tau[1] - tau[0]) / 2.0 == pytest.approx(c * cos - tau.sum() / 2.0 * sin, rel=1e-3)


def test_tension_leads_to_the_apex_or_is_refused():
    """Stress ``c / tan(phi)`` in all directions; without dilatancy no flow lowers it, and the state has no stress."""
    phi, c = 0.5, 0.15
    soil = pd.DruckerPrager(E, NU, cohesion=c, friction=phi)
    F = np.exp(0.05) * np.eye(3)[None]
    points = Points(soil, 3, 1)
    assert np.allclose(points.stress(F) @ F[0].T, c / np.tan(phi) * np.eye(3), rtol=1e-12, atol=1e-14)
    assert points.at.defined(F)
    assert not Points(dataclasses.replace(soil, dilatancy=0.0), 3, 1).at.defined(F)


def test_work_is_the_energy_of_flow_that_is_not_associated():
    """The stress has no potential there: its work along a path of small steps is what energy has grown by."""
    points = points_of("not_associated", "solid", 2)
    way = np.array([np.diag([0.1, -0.08, 0.03]), [[0.0, 0.1, 0.0], [0.05, -0.05, 0.0], [0.0, 0.0, 0.02]]])
    work, F = np.zeros(2), np.tile(np.eye(3), (2, 1, 1))
    P = points.stress(F)
    for step in range(1, 201):
        after = np.eye(3) + way * np.sin(step / 200 * 2.0)
        points.commit(after)
        later = points.stress(after)
        work += 0.5 * np.einsum("pij,pij->p", P + later, after - F)
        F, P = after, later
    assert points.alpha.min() > 0.01
    assert np.allclose(points.energy(F), work, rtol=2e-3)


@pytest.mark.parametrize("name", TIMED)
def test_slow_loading_is_that_of_the_law_without_a_rate(name):
    slow = dataclasses.replace(LAWS[name].rate, duration=1e9)
    heat = getattr(slow, "heat", 1.0)
    law = dataclasses.replace(LAWS[name], rate=slow)
    without = dataclasses.replace(
        law, rate=rates.JohnsonCook(1e9, 0.0, 1.0, 500.0, 300.0, 1300.0, 1.1) if heat < 1.0 else None
    )
    F = np.tile(np.diag([1.1, 0.97, 0.98]), (1, 1, 1))
    found = []
    for material in (law, without):
        points = Points(material, 3, 1)
        points.t = 1.0
        found.append(points.stress(F))
    assert np.allclose(found[0], found[1], rtol=1e-4)
    assert not np.allclose(found[0], Points(LAWS[name], 3, 1).stress(F), rtol=1e-2)


def test_constants_may_be_in_any_unit():
    """A law whose stresses are a million times larger, or smaller, answers the same."""
    F = np.array([[[1.1, 0.05], [0.02, 0.97]]])
    found = []
    for unit in (1e-12, 1.0, 1e12):
        hardening = hard.Linear(0.4 * unit) + hard.Voce(0.4 * unit, 8.0) + hard.Power(0.2 * unit, 0.3)
        rate = rates.Perzyna(DURATION, 0.5, 0.3 * unit, 2.0)
        points = Points(pd.J2(E * unit, NU, "stress", yield_stress=Y * unit, hardening=hardening, rate=rate), 2, 1)
        points.t = 0.5
        found.append((points.stress(F) / unit, points.tangent(F) / unit))
    for P, A in found:
        assert np.allclose(P, found[1][0], rtol=1e-10)
        assert np.allclose(A, found[1][1], rtol=1e-9)


@pytest.mark.parametrize("kind", ["strain", "stress", "solid"])
@pytest.mark.parametrize("name", ["voce", "drucker_prager"])
def test_the_tangent_of_a_body_that_yields_at_tiny_strains_is_exact(name, kind, rng):
    """Principal strains lie closer together than those of steel by far, and stresses turn within them all the same."""
    size, (dim, plane) = 1e-5, BODIES[kind]
    law = {
        "voce": pd.J2(E, NU, plane, yield_stress=Y * size, hardening=hard.Voce(0.4 * size, 8.0 / size)),
        "drucker_prager": pd.DruckerPrager(
            E, NU, plane, cohesion=0.15 * size, friction=0.5, dilatancy=0.2, hardening=0.4
        ),
    }[name]
    points = Points(law, dim)
    F = np.eye(dim) + 0.1 * size * (rng.standard_normal((N, dim, dim)) - np.eye(dim) * (name != "voce"))
    points.commit(np.eye(dim) + 0.3 * (F - np.eye(dim)))
    A, different = points.tangent(F), np.empty((N, dim, dim, dim, dim))
    step = 5.0 * STEP * size * np.eye(dim * dim).reshape(dim, dim, dim, dim)
    for i, m in np.ndindex(dim, dim):
        change = points.stress(F + step[i, m]) - points.stress(F - step[i, m])
        different[..., i, m] = change / (2.0 * step[i, m, i, m])
    assert np.abs(A - different).max() < 2e-3 * np.abs(A).max()


@pytest.mark.parametrize("name", ["voce", "perzyna"])
def test_the_tangent_of_a_body_in_plane_stress_is_that_of_differences(name, rng):
    model = body(2, material=dataclasses.replace(LAWS[name], plane="stress"), rng=rng)
    u = displacement(model, rng, size=0.2)
    model.commit(0.5 * u)
    columns = range(0, u.size, 7)
    K = dense_tangent(model, u)
    assert np.abs(K[:, columns] - differences(model, u, columns)).max() < 1e-7 * np.abs(K).max()
    du = rng.standard_normal(u.shape)
    assert np.allclose(model.tangent_times(u, du).ravel(), K @ du.ravel(), rtol=1e-11, atol=1e-11 * np.abs(K).max())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: hard.Tabular([0.0, 0.1], [0.0, -1.0]), "do not fall"),
        (lambda: hard.Tabular([0.1, 0.2], [0.0, 1.0]), "ascend from 0"),
        (lambda: hard.Power(1.0, 1.5), "exponent n of at most 1"),
        (lambda: hard.Voce(1.0, 0.0), "a positive number as b"),
        (lambda: hard.Linear(-1.0), "a finite number >= 0 as H"),
        (lambda: rates.Perzyna(0.0, 1.0, 1.0), "a positive number as duration"),
        (lambda: rates.JohnsonCook(1.0, 0.1, 1.0, temperature=1900.0), "below that of melting"),
        (lambda: pd.J2(1.0, nu=0.0, yield_stress=0.1, hardening="voce"), "Hardening as hardening"),
    ],
)
def test_wrong_laws_are_refused(make, message):
    with pytest.raises(pd.CaseError, match=message):
        make()


@pytest.mark.parametrize("name", ["kinematic_perzyna", pytest.param("perzyna", marks=pytest.mark.long)])
def test_a_run_that_stops_goes_on_as_if_it_had_not(name, tmp_path):
    """On two ranks from a checkpoint of one: the same as a run on one rank without a stop."""
    plane = "strain" if name == "not_associated" else "stress"
    words = (f"law={name}", f"plane={plane}")
    whole = results(CASE, *words, output=tmp_path / "whole")
    case = load_case(ROOT / CASE)
    with pytest.raises(pd.Interrupted):
        pd.run(case(law=name, plane=plane, stop=0.5), output=tmp_path / "half")
    again = results(
        CASE, *words, "--restart-anyway", "--restart", tmp_path / "half", ranks=2, output=tmp_path / "again"
    )
    assert again["results"]["force"] == pytest.approx(whole["results"]["force"], rel=1e-8)
    for quantity in ("displacement", "stress", "plastic_strain"):
        one, two = (field(tmp_path / run, quantity) for run in ("whole", "again"))
        assert np.abs(one - two).max() <= 1e-8 * max(np.abs(one).max(), 1e-3), quantity


@pytest.mark.parametrize("name", ["voce", "kinematic_perzyna", "not_associated"])
def test_runs_with_and_without_a_matrix_are_the_same(name, tmp_path):
    plane = "strain" if name == "not_associated" else "stress"
    case = load_case(ROOT / CASE)(law=name, plane=plane)
    found = []
    for options in ({}, {"pd_jacobian": "matfree", "ksp_rtol": 1e-10}):
        found.append(pd.run(dataclasses.replace(case, options=options), output=tmp_path)["force"])
    assert found[1] == pytest.approx(found[0], rel=1e-7)


@pytest.mark.parametrize("name", ["voce", "maxwell"])
def test_a_body_in_another_unit_of_length_is_the_same_body(name, tmp_path):
    case = load_case(ROOT / CASE)
    one, other = (pd.run(case(law=name, cell=cell), output=tmp_path).history for cell in (1.0, 1e-9))
    assert np.allclose(np.multiply(other["force"], 1e9), one["force"], rtol=1e-8)
    assert np.allclose(other["plastic"], one["plastic"], rtol=1e-8, atol=1e-12)


@pytest.mark.long
def test_steps_are_cut_where_plastic_strain_grows_by_too_much(tmp_path):
    case = load_case(ROOT / CASE)
    free = pd.run(case(), output=tmp_path).history["plastic"]
    assert np.diff(free).max() > 0.015
    held = pd.run(case(growth=0.01), output=tmp_path).history
    assert len(held["t"]) > len(free)
    assert held["t"][-1] == 1.0
    # The largest value over particles grows by no more than that at any of their points.
    assert np.diff(held["plastic"]).max() <= 0.01
    with pytest.raises(pd.SolveError, match=r"plastic strain grew by .* in one step"):
        pd.run(case(growth=1e-6), output=tmp_path)


def test_a_run_into_states_without_stress_ends_in_one_sentence(tmp_path):
    """A cell of soil that does not dilate is pulled in both directions, beyond the apex of its cone."""
    soil = dataclasses.replace(LAWS["drucker_prager"], dilatancy=0.0)
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (4.0, 4.0), 1.0),
        horizon=1.515,
        material=soil,
        scheme=pd.Correspondence(),
        control=pd.Silling(0.5),
        cell=pd.Cell((0.0, 0.0), (4.0, 4.0)),
        conditions=[pd.Displacement(pd.region.Nearest((0.5, 0.5)), x=0.0, y=0.0), pd.MeanStrain(xx=0.1, yy=0.1)],
        steps=pd.Steps(2),
    )
    with pytest.raises(pd.SolveError, match=r"No convergence from step time 0.*a material has no stress"):
        pd.run(case, output=tmp_path)


def test_a_law_with_a_rate_needs_load_steps(tmp_path):
    case = load_case(ROOT / CASE)
    with pytest.raises(pd.CaseError, match="which is no time"):
        pd.run(case(law="perzyna", solver="path"), output=tmp_path)


def test_a_tangent_that_is_not_symmetric_is_not_factorised_as_one(tmp_path):
    case = load_case(ROOT / CASE)
    for name, chosen in (("drucker_prager", "cholesky"), ("not_associated", "lu")):
        pd.run(case(law=name, plane="strain", steps=2), output=tmp_path)
        assert summary(tmp_path)["options"]["pc_type"]["value"] == chosen


def test_one_time_goes_by_in_a_case(tmp_path):
    """Whatever has a duration has the same one: rate laws, graded or not, Maxwell elements and conduction."""
    left, right = pd.region.Slab("x", high=2.0), pd.region.Slab("x", low=2.0)

    def perzyna(duration):
        return pd.J2(100.0, 0.3, yield_stress=0.5, rate=rates.Perzyna(duration, rate_0=1.0, drag=0.1))

    def kinematic(duration):
        rate = rates.Perzyna(duration, rate_0=1.0, drag=0.1)
        return pd.KinematicJ2(100.0, 0.3, yield_stress=0.5, kinematic=1.0, rate=rate)

    def made(one, other, heat=None):
        return pd.Case(
            particles=pd.Lattice((0.0, 0.0), (4.0, 4.0), 1.0),
            horizon=1.515,
            material=[(left, one), (right, other)],
            conditions=[pd.Displacement(left, x=0.0, y=0.0)],
            heat=heat,
        )

    def graded(x):
        return 1.0 + x[:, 0]

    maxwell, elastic = pd.Maxwell(100.0, 0.3, shear=[1.0], times=[1.0], duration=1.0), pd.LinearElastic(100.0, 0.3)
    warm = pd.Thermal(pd.Graded(perzyna(2.0), graded), 1e-3)
    for one, other, heat, names in (
        (perzyna(1.0), perzyna(100.0), None, "J2 of material 1 has 1, J2 of material 2 has 100"),
        (kinematic(1.0), warm, None, "KinematicJ2 of material 1 has 1, J2 of material 2 has 2"),
        (elastic, maxwell, pd.HeatConduction(duration=3.0), "Maxwell of .* has 1, HeatConduction has 3"),
        (warm, maxwell, None, "J2 of material 1 has 2, Maxwell of material 2 has 1"),
    ):
        with pytest.raises(pd.CaseError, match=names):
            made(one, other, heat)
    made(perzyna(1.0), maxwell, pd.HeatConduction(duration=1.0))
    made(perzyna(5.0), elastic, pd.HeatConduction())
    made(elastic, dataclasses.replace(perzyna(5.0), rate=None), pd.HeatConduction(duration=3.0))
    # Nor has a law another time when it is hot.
    other = pd.Thermal(perzyna(1.0), 1e-3, law=lambda T: perzyna(1.0 + T))
    with pytest.raises(pd.CaseError, match=r"the duration 1.0 of its material, not 8.0 at temperature 7"):
        other.material_at(7.0, other.material)
    assert other.material_at(0.0, other.material).duration == 1.0


def runaway(material, pull, n=10):
    """Return a strip that is pulled at its end."""
    left, right = pd.region.Slab("x", high=1.0), pd.region.Slab("x", low=n - 1.0)
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (float(n), 3.0), 1.0),
        horizon=1.515,
        material=material,
        scheme=pd.Correspondence(),
        control=pd.Silling(0.5),
        conditions=[
            pd.Displacement(left, x=0.0),
            pd.Displacement(pd.region.Box((0.0, 0.0), (1.0, 1.0)), y=0.0),
            pd.Traction(right, x=pull, normal=(1.0, 0.0)),
        ],
        steps=pd.Steps(5),
        history={"u": pd.Mean(pd.displacement, "x", right), "alpha": pd.Largest(pd.plastic_strain)},
    )


@pytest.mark.processors
@pytest.mark.parametrize("size", [1.0, 2.0**-30], ids=["as it is", "in another unit of force"])
def test_a_body_beyond_its_limit_load_is_in_no_equilibrium(size, tmp_path):
    """The strip carries the yield stress; the next load step would move it without end."""
    perfect = pd.KinematicJ2(100.0 * size, 0.3, plane="stress", yield_stress=size)
    with pytest.raises(pd.SolveError, match="above the limit load of the body"):
        pd.run(runaway(perfect, 1.2 * size), tmp_path)
    steps = summary(tmp_path)["steps"]
    # Its ends, which the boundaries of the gradients stiffen, carry a little more.
    assert 0.98 <= 1.2 * steps[-1]["t"] <= 1.01


@pytest.mark.parametrize("far", [10.0, 1e4, 1e8])
def test_an_iterate_that_runs_away_raises_no_tolerance(far):
    """Its reactions and its round-off are as large as its displacement; the step involves the load alone."""
    load = 3 * 0.9
    hard = pd.KinematicJ2(100.0, 0.3, plane="stress", yield_stress=1.0, hardening=10.0)
    prepared = pd.prepare(runaway(hard, 0.9))
    solver = prepared.make_solver()
    try:
        u, result = solver.solve(np.zeros((30, 2)), 0.5)
        assert result.converged
        solver.problem.commit(solver.state(u))
        sought = solver._equilibrium
        sought.impose(1.0)
        sought.begin(u)
        sought.resist(np.zeros_like(u))
        x = solver.problem.body.cloud.x[:30]
        away = np.where(sought.free, u + far * np.stack([x[:, 0] + 0.05 * x[:, 0] ** 2, 0.1 * x[:, 1]], axis=1), u)
        for iteration in (0, 1):
            assert sought.residual(away.ravel()) is not None
            assert sought.verdict(away.ravel(), iteration, 1e-4 * load, 1e-10) is None
            assert not sought.judge(away.ravel(), 1e-10)
        assert sought.reference <= 2.01 * load
    finally:
        solver.destroy()


def test_a_step_that_moves_a_body_by_more_than_its_size_is_shortened(tmp_path):
    """A bar of rubber that is drawn to several times its length: forces balance, and the message says what is wrong."""
    bar = pd.Case(
        particles=pd.Lattice((0.0,), (8.0,), 1.0), horizon=1.515, material=pd.NeoHookean(E=1.0, nu=0.3),
        conditions=[pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0), pd.Force(pd.region.Slab("x", low=7.0), x=3)],
        steps=pd.Steps(1, smallest=1.0),
    )  # fmt: skip
    with pytest.raises(pd.SolveError, match="move the body by more than its own size in one step"):
        pd.run(bar, tmp_path / "one")
    found = pd.run(dataclasses.replace(bar, steps=pd.Steps(1)), tmp_path / "several")
    assert len(found.summary["steps"]) > 1


def test_the_first_comparison_of_forces_does_not_depend_on_the_solve_before():
    """A run that goes on from a checkpoint has none: what counts as zero in its prediction is the same."""
    hard = pd.KinematicJ2(100.0, 0.3, plane="stress", yield_stress=1.0, hardening=10.0)
    found = []
    for before in (None, 0.5, -8.0):
        solver = pd.prepare(runaway(hard, 0.9)).make_solver()
        try:
            if before is not None:
                solver.solve(np.zeros((30, 2)), before)
                solver.problem.revert()
            sought = solver._equilibrium
            sought.impose(1.0)
            sought.begin(np.zeros((30, 2)))
            sought.update(sought.state(np.zeros(60)))
            sought.resist(np.zeros((30, 2)))
            found.append(sought._tolerance(np.zeros(60), 1e-6))
        finally:
            solver.destroy()
    assert found[0][0] > 0.0
    assert found[1] == pytest.approx(found[0], rel=1e-12) == found[2]


def test_a_linear_body_may_be_displaced_without_end(tmp_path):
    """The law has no scale: with a load of any size the answer is that of a small one."""
    found = [
        pd.run(runaway(pd.LinearElastic(100.0, 0.3, "stress"), pull), tmp_path / f"{pull:g}").history["u"][-1] / pull
        for pull in (1.0, 1e12)
    ]
    assert found[1] == pytest.approx(found[0], rel=1e-9)


def test_a_slender_linear_beam_takes_a_load_of_any_size(tmp_path):
    """Its reactions are 500 times its load, and the round-off of its forces is that of large displacements."""
    found = []
    for load in (1e-3, 1e-9):
        left, right = pd.region.Slab("x", high=2.0), pd.region.Slab("x", low=1499.0)
        beam = pd.Case(
            particles=pd.Lattice((0.0, 0.0), (1500.0, 3.0), 1.0), horizon=1.515, steps=pd.Steps(1, smallest=1.0),
            material=pd.LinearElastic(1.0, 0.3, "stress"), history={"v": pd.Mean(pd.displacement, "y", right)},
            conditions=[pd.Displacement(left, x=0.0, y=0.0), pd.Force(right, y=load)],
        )  # fmt: skip
        found.append(pd.run(beam, tmp_path / f"{load:g}").history["v"][-1] / load)
    assert found[1] == pytest.approx(found[0], rel=1e-4)
