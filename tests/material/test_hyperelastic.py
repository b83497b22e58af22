"""Materials from a strain energy: against laws written by hand, closed forms, and what is refused."""

import dataclasses
import os
import subprocess
import sys

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import ROOT, results, script_on, summary
from tests.material.test_material import Law, derivative, gradients
from tests.scenes import rotation

E, NU = 10.0, 0.3
LAM, MU = pd.LinearElastic(E, NU).lame(3)
NEO = "mu/2 * (I1 - 3 - 2*log(J)) + lam/2 * log(J)**2"
BY_HAND = {
    "neo_hookean": (pd.NeoHookean(E, NU), NEO),
    "saint_venant_kirchhoff": (pd.SaintVenantKirchhoff(E, NU), "lam/8*(I1 - 3)**2 + mu/4*(I1**2 - 2*I2 - 2*I1 + 3)"),
    "hencky": (pd.Hencky(E, NU), "lam/2*log(J)**2 + mu*(log(l1)**2 + log(l2)**2 + log(l3)**2)"),
}
BODIES = [(1, "strain"), (2, "strain"), (2, "stress"), (3, "strain")]
A = np.array([0.6, 0.8, 0.0])
EVERYTHING = (
    "mu/2*(I1bar - 3) + mu/5*(I2bar - 3) + kappa/2*(J - 1)**2 + k/2*(I4 - 1)**2 + k/7*(I5 - 1)**2"
    " + k/9*(I4 - 1)*(I5 - 1) + k/5*(I6bar - 1)**2 + k/3*(I7bar - 1)**2 + k/4*pos(I4bar - 1)**3"
)


def fibres(dim):
    """Return two directions of a body."""
    return {"fibre": A[:dim] if dim > 1 else (1.0,), "second_fibre": (A[1], -A[0], 0.0)[:dim] if dim > 1 else (-1.0,)}


LAWS = {
    "mooney_rivlin": lambda dim: pd.MooneyRivlin(1.0, 0.5, 10.0),
    "yeoh": lambda dim: pd.Yeoh(1.0, -0.05, 0.01, 10.0),
    "ogden": lambda dim: pd.Ogden((0.63, 0.0012, -0.01), (1.3, 5.0, -2.0), 5.0),
    "fibres": lambda dim: pd.Hyperelastic(EVERYTHING, mu=1.0, kappa=5.0, k=3.0, **fibres(dim)),
    "gasser": lambda dim: pd.HolzapfelGasserOgden(1.0, 2.0, 0.3, 5.0, **fibres(dim), dispersion=0.1),
}
QUICK = {("mooney_rivlin", 2, "stress"), ("ogden", 3, "strain"), ("fibres", 3, "strain"), ("gasser", 2, "stress")}
CASES = [
    pytest.param(name, dim, plane, marks=() if (name, dim, plane) in QUICK else pytest.mark.long)
    for name in LAWS
    for dim, plane in BODIES
]


# Every law is generated and compiled anew; each of them, and each kind of body, is in the default suite.
OTHERS = {
    ("hencky", 1, "strain"), ("hencky", 2, "stress"), ("neo_hookean", 1, "strain"), ("neo_hookean", 3, "strain"),
    ("saint_venant_kirchhoff", 2, "strain"), ("saint_venant_kirchhoff", 3, "strain"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "dim", "plane"),
    [
        pytest.param(name, dim, plane, marks=pytest.mark.long if (name, dim, plane) in OTHERS else ())
        for name in BY_HAND
        for dim, plane in BODIES
    ],
)
def test_a_law_written_by_hand_is_the_same(name, dim, plane, rng):
    by_hand, text = BY_HAND[name]
    hand = dataclasses.replace(by_hand, plane=plane)
    text = pd.Hyperelastic(text, plane, mu=MU, lam=LAM)
    F = gradients(dim, rng)
    if name == "saint_venant_kirchhoff":  # no thickness in plane stress, no stable one, far from F = I
        F = np.eye(dim) + 0.4 * (F - np.eye(dim))
    one, other = Law(hand, dim, len(F)), Law(text, dim, len(F))
    for quantity in ("stress", "tangent", "energy", "out_of_plane_stress"):
        a, b = getattr(one, quantity)(F), getattr(other, quantity)(F)
        assert np.allclose(a, b, rtol=1e-10, atol=1e-10 * max(1.0, np.abs(a).max())), quantity
    across = text.hidden_stretch(F, np.empty((len(F), 0)))
    assert np.allclose(hand.hidden_stretch(F, np.empty((len(F), 0))) if dim < 3 else 1.0, across, rtol=1e-10)
    assert text.young_modulus() == pytest.approx(E, rel=1e-12)
    assert np.allclose(text.moduli(dim), hand.moduli(dim), atol=1e-12 * E)
    assert text.bulk_like_modulus(dim) == pytest.approx(hand.bulk_like_modulus(dim), rel=1e-12)
    assert text.largest_modulus(dim) == pytest.approx(hand.largest_modulus(dim), rel=1e-12)


@pytest.mark.parametrize(("name", "dim", "plane"), CASES)
def test_stress_and_tangent_are_derivatives_and_turn_with_the_body(name, dim, plane, rng):
    material = dataclasses.replace(LAWS[name](dim), plane=plane)
    F = gradients(dim, rng)
    if name in ("fibres", "gasser"):  # fibres begin to bear where they are neither stretched nor shortened
        F = F[:-3]
    law = Law(material, dim, len(F))
    P, tangent, energy = law.stress(F), law.tangent(F), law.energy(F)
    assert np.abs(P - derivative(law.energy, F, dim)).max() < 1e-8 * np.abs(P).max()
    assert np.abs(tangent - derivative(law.stress, F, dim)).max() < 1e-8 * np.abs(tangent).max()
    assert np.abs(tangent - tangent.transpose(0, 3, 4, 1, 2)).max() < 1e-12 * np.abs(tangent).max()
    Q = rotation(dim, rng)
    assert np.allclose(law.stress(Q @ F), Q @ P, atol=1e-10 * np.abs(P).max())
    assert np.allclose(law.energy(Q @ F), energy, rtol=1e-9)
    kirchhoff = np.einsum("pij,pkj->pik", P, F)
    assert np.abs(kirchhoff - kirchhoff.transpose(0, 2, 1)).max() < 1e-12 * np.abs(kirchhoff).max()
    start = Law(material, dim, 1)
    undeformed = np.eye(dim)[None]
    assert np.abs(start.stress(undeformed)).max() < 1e-14 * material.largest_modulus(dim)
    assert abs(start.energy(undeformed)[0]) < 1e-14 * material.largest_modulus(dim)
    assert np.allclose(start.tangent(undeformed)[0], material.moduli(dim), atol=1e-13 * material.largest_modulus(dim))


@pytest.mark.parametrize("name", ["mooney_rivlin", pytest.param("gasser", marks=pytest.mark.long)])
def test_free_sides_are_those_of_the_solid(name, rng):
    """The solid with the stretches that bar and plane body find has no stress there, and theirs in the plane."""
    for dim in (1, 2):
        material = dataclasses.replace(LAWS[name](dim), plane="stress")
        F = gradients(dim, rng)
        law = Law(material, dim, len(F))
        directions = {key: np.append(value, np.zeros(3 - dim)) for key, value in fibres(dim).items()}
        whole = dataclasses.replace(material, **(directions if name == "gasser" else {}))
        b = material.hidden_stretch(F, law.history) ** (1.0 / (3 - dim))
        full = np.tile(np.eye(3), (len(F), 1, 1)) * b[:, None, None]
        full[:, :dim, :dim] = F
        P = Law(whole, 3, len(F)).stress(full)
        size = np.abs(P).max()
        assert np.allclose(P[:, :dim, :dim], law.stress(F), atol=1e-11 * size)
        assert np.abs(P[:, 2, 2]).max() < 1e-11 * size
        assert np.allclose(law.out_of_plane_stress(F), 0.0)


def test_uniaxial_and_equibiaxial_tests_have_their_closed_forms():
    """Incompressible bodies; the error of a finite bulk modulus is the stress over it."""
    stretch = np.array([0.6, 0.9, 1.0, 1.5, 3.0, 5.0])
    F, kappa = stretch[:, None, None], 1e6
    P = Law(pd.MooneyRivlin(0.3, 0.1, kappa), 1, len(F)).stress(F)[:, 0, 0]
    assert np.allclose(P, 2.0 * (stretch - stretch**-2) * (0.3 + 0.1 / stretch), atol=1e-5)
    mu, alpha = np.array([0.63, 0.0012, -0.01]), np.array([1.3, 5.0, -2.0])
    rubber = pd.Ogden(mu, alpha, kappa, plane="stress")
    P = Law(rubber, 1, len(F)).stress(F)[:, 0, 0]
    powers = [stretch ** (a - 1.0) - stretch ** (-0.5 * a - 1.0) for a in alpha]
    assert np.allclose(P, mu @ powers, rtol=1e-4, atol=1e-5)
    P = Law(rubber, 2, len(F)).stress(F * np.eye(2))
    powers = [stretch ** (a - 1.0) - stretch ** (-2.0 * a - 1.0) for a in alpha]
    assert np.allclose(P[:, 0, 0], mu @ powers, rtol=1e-4, atol=1e-5)
    assert np.allclose(P[:, 0, 0], P[:, 1, 1])
    assert 0.5 * mu @ alpha == pytest.approx(rubber.moduli(3)[0, 1, 0, 1], rel=1e-9)


def test_simple_shear_has_the_stresses_of_a_mooney_rivlin_body():
    c10, c01, shear = 0.3, 0.1, 0.8
    F = np.eye(3)
    F[0, 1] = shear
    P = Law(pd.MooneyRivlin(c10, c01, 7.0), 3, 1).stress(F[None])[0]
    sigma = P @ F.T
    assert sigma[0, 1] == pytest.approx(2.0 * (c10 + c01) * shear, rel=1e-13)
    assert sigma[0, 0] - sigma[2, 2] == pytest.approx(2.0 * c10 * shear**2, rel=1e-12)
    assert sigma[1, 1] - sigma[2, 2] == pytest.approx(-2.0 * c01 * shear**2, rel=1e-12)


def test_fibres_with_dispersion_have_their_closed_forms():
    """A bar along its fibres, and a sheet with two families; incompressible, Gasser2006."""
    c, k1, k2, d, kappa = 1.0, 2.0, 0.8, 0.15, 1e7
    stretch = np.array([0.8, 1.05, 1.2, 1.4])
    bar = pd.HolzapfelGasserOgden(c, k1, k2, kappa, fibre=(1.0,), dispersion=d)
    P = Law(bar, 1, 4).stress(stretch[:, None, None])[:, 0, 0]
    strain = np.maximum(d * (stretch**2 + 2.0 / stretch - 3.0) + (1.0 - 3.0 * d) * (stretch**2 - 1.0), 0.0)
    slope = d * (2.0 * stretch - 2.0 / stretch**2) + (1.0 - 3.0 * d) * 2.0 * stretch
    assert np.allclose(P, c * (stretch - stretch**-2) + k1 * strain * np.exp(k2 * strain**2) * slope, rtol=1e-5)
    angle = np.radians(40.0)
    along = np.array([np.cos(angle), np.sin(angle)])
    sheet = pd.HolzapfelGasserOgden(
        c, k1, k2, kappa, fibre=along, second_fibre=along * (1.0, -1.0), dispersion=d, plane="stress"
    )
    l = np.array([1.3, 1.1])
    l3 = 1.0 / (l[0] * l[1])
    P = Law(sheet, 2, 1).stress(np.diag(l)[None])[0]
    strain = d * (l @ l + l3**2 - 3.0) + (1.0 - 3.0 * d) * (along**2 @ l**2 - 1.0)
    slope = 2.0 * d * (l - l3**2 / l) + 2.0 * (1.0 - 3.0 * d) * l * along**2
    expected = c * (l - l3**2 / l) + 2.0 * k1 * strain * np.exp(k2 * strain**2) * slope
    assert np.allclose(np.diag(P), expected, rtol=1e-5)
    assert np.abs(P - np.diag(np.diag(P))).max() < 1e-12


def test_other_units_scale_the_stress(rng):
    F = gradients(2, rng)
    one = Law(pd.MooneyRivlin(0.3, 0.1, 7.0, plane="stress"), 2, len(F)).stress(F)
    for unit in (1e-20, 1e20):
        other = Law(pd.MooneyRivlin(0.3 * unit, 0.1 * unit, 7.0 * unit, plane="stress"), 2, len(F)).stress(F)
        assert np.allclose(other / unit, one, rtol=1e-12, atol=1e-13)


REFUSED = {
    "has the stress -0.5 at F = I": ("c/2 * (I1 - 3) + k/2*(J - 1.5)**2", {"c": 1.0, "k": 3.0}),
    "has the stress 1 at F = I": ("c/2*(l1**2 + l2**2 + l3**2 - 3)", {"c": 1.0}),
    "names lam, which is neither": ("lam/2*log(J)**2", {}),
    "names I8": ("I8**2", {}),
    "does not use the constant mu": ("lam/2*log(J)**2", {"lam": 1.0, "mu": 1.0}),
    "takes a number as constant mu, not 'soft'": (NEO, {"mu": "soft", "lam": 1.0}),
    "takes a number as constant mu, not None": (NEO, {"mu": None, "lam": 1.0}),
    "takes a number as constant mu, not nan": (NEO, {"mu": np.nan, "lam": 1.0}),
    "least eigenvalue of its small-strain stiffness is .*, not positive": ("lam/2*log(J)**2", {"lam": 1.0}),
    "is not stable at F = I": (NEO, {"mu": -1.0, "lam": 1.0}),
    "changes when l1, l2 and l3 are exchanged": ("c*(l1 - 1)**2 + c*log(J)**2", {"c": 1.0}),
    "reads a direction that is not given; give fibre=": (f"{NEO} + mu*(I4 - 1)**2", {"mu": 1.0, "lam": 1.0}),
    "has principal stretches and invariants of fibres": ("c*(l1+l2+l3-3)**2 + c*(I4-1)**2", {"c": 1.0}),
    "cannot be read at character": ("mu *", {"mu": 1.0}),
    "a power is \\*\\*": ("mu ^ 2", {"mu": 1.0}),
    "calls a function that is not one of": ("__import__('os').system('true')", {}),
    "may have numbers, names": ("[x for x in (1, 2)]", {}),
    "has 'mu' where a number belongs": ("'mu' * I1", {}),
    "too large": ("9**9**9**9**9 * I1", {}),
    "exp of a number that is too large": ("exp(9**99) * I1", {}),
    "has an exponent beyond 512": ("(I1**64)**64", {}),
    "nested|cannot be read": ("-" * 3000 + "I1", {}),
    "has a number with too many digits": ("1" * 400 + " * I1", {}),
    "is not finite": ("log(0) * I1", {}),
    "divides by zero": ("I1 / 0", {}),
    "I1 cannot be the name of a constant": (NEO, {"I1": 1.0}),
    "may have 4000 characters": ("1 + " * 1001 + "I1", {}),
    "has no finite stress": ("mu*(I1-3-2*log(J)) + lam*sqrt(J-1)*log(J)", {"mu": 1.0, "lam": 1.0}),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_is_no_energy_is_refused(message):
    text, constants = REFUSED[message]
    with pytest.raises(pd.CaseError, match=message) as refused:
        pd.Hyperelastic(text, **constants)
    assert str(refused.value).endswith(".") and "\n" not in str(refused.value)


@pytest.mark.parametrize("fibre", [(1.0, 1.0), (0.0, 0.0), "x", 1.0, (np.nan, 0.0), [[1.0, 0.0]]])
def test_a_direction_that_is_no_unit_vector_is_refused(fibre):
    with pytest.raises(pd.CaseError, match=r"unit vector|as fibre"):
        pd.Hyperelastic(f"{NEO} + mu*(I4 - 1)**2", mu=1.0, lam=1.0, fibre=fibre)


def strip(material, **changes):
    """Return a strip that is pulled."""
    left, right = pd.region.Slab("x", high=1.0), pd.region.Slab("x", low=7.0)
    declared = {
        "particles": pd.Lattice((0.0, 0.0), (8.0, 4.0), 1.0),
        "horizon": 2.015,
        "material": material,
        "control": pd.Silling(0.5),
        "conditions": [pd.Displacement(left, x=0.0, y=0.0), pd.Displacement(right, x=0.8)],
        "history": {"force": pd.Reaction("x", right), "turned": pd.Mean(pd.displacement, "y")},
        "results": lambda h: {"force": h["force"][-1], "turned": h["turned"][-1]},
    }
    return pd.Case(**(declared | changes))


def reinforced(fibre):
    return pd.Hyperelastic(f"{NEO} + k/2*(I4 - 1)**2", "stress", fibre=fibre, mu=1.0, lam=2.0, k=3.0)


def turning(x):
    """Return directions that turn with the place, and do not know what to make of places outside of the strip."""
    if len(x) == 0 or x.max() > 8.0 or x.min() < 0.25:
        raise ValueError("outside")
    return np.stack([np.cos(0.3 * x[:, 0]), np.sin(0.3 * x[:, 0])], axis=1)


def test_a_body_of_the_law_by_hand_is_the_same(tmp_path):
    """Newton takes the same iterations to the same force, in plane stress with a strain that is not uniform."""
    hand, text = (
        pd.run(strip(material, steps=pd.Steps(2)), output=tmp_path / name)
        for name, material in (
            ("hand", pd.NeoHookean(E, NU, "stress")),
            ("text", pd.Hyperelastic(NEO, "stress", mu=MU, lam=LAM)),
        )
    )
    assert text["force"] == pytest.approx(hand["force"], rel=1e-10)
    one, other = (
        [step["newton_iterations"] for step in summary(tmp_path / name)["steps"]] for name in ("hand", "text")
    )
    assert one == other and max(one) > 1


def test_fibres_beyond_a_mirror_plane_are_mirrored(tmp_path):
    """Half a strip with its mirror plane is the whole strip with mirrored fibres."""
    whole = strip(reinforced(lambda x: np.stack([np.full(len(x), 0.6), np.where(x[:, 0] < 4.0, -0.8, 0.8)], axis=1)))
    low, high = pd.region.Slab("x", high=1.0), pd.region.Slab("x", low=7.0)
    ends = [pd.Displacement(low, x=-0.4, y=0.0), pd.Displacement(high, x=0.4, y=0.0)]
    history = {"force": pd.Reaction("x", high), "shift": pd.Largest(pd.displacement, "y")}
    found = {"results": lambda h: {name: h[name][-1] for name in ("force", "shift")}, "history": history}
    whole = dataclasses.replace(whole, conditions=ends, **found)
    half = dataclasses.replace(
        whole,
        particles=pd.Lattice((4.0, 0.0), (8.0, 4.0), 1.0),
        material=reinforced((0.6, 0.8)),
        conditions=ends[1:],
        symmetry=[pd.Symmetry("x", at=4.0)],
    )
    one, other = pd.run(whole, output=tmp_path / "whole"), pd.run(half, output=tmp_path / "half")
    assert other["force"] == pytest.approx(one["force"], rel=1e-8)
    assert other["shift"] == pytest.approx(one["shift"], rel=1e-8)
    assert one["shift"] > 1e-3


def test_fibres_may_follow_a_function_of_place(tmp_path):
    constant = pd.run(strip(reinforced((0.6, 0.8))), output=tmp_path / "a")
    same = pd.run(strip(reinforced(lambda x: np.tile((0.6, 0.8), (len(x), 1)))), output=tmp_path / "b")
    assert same["force"] == pytest.approx(constant["force"], rel=1e-8)
    assert abs(constant["turned"]) > 1e-3
    field = pd.run(strip(reinforced(turning)), output=tmp_path / "c")
    assert field["force"] != pytest.approx(constant["force"], rel=1e-2)
    graded = pd.run(strip(pd.Graded(reinforced(turning), lambda x: np.full(len(x), 2.0))), output=tmp_path / "d")
    assert graded["force"] == pytest.approx(2.0 * field["force"], rel=1e-8)


@pytest.mark.parametrize(
    ("fibre", "message"),
    [
        (lambda x: np.ones((len(x), 2)), "it must be a unit vector"),
        (lambda x: np.ones(len(x)), "must return one vector per particle"),
        (lambda x: 1 / 0, "failed"),
        ((0.6, 0.8, 0.0), "have 3 components, but the body has 2 dimensions"),
    ],
)
def test_wrong_directions_of_a_body_are_refused(fibre, message):
    with pytest.raises(pd.CaseError, match=message):
        pd.prepare(strip(reinforced(fibre)))


def test_damage_is_refused_where_every_direction_has_its_own_modulus():
    damage = pd.Brittle(pd.FractureEnergy(0.5))
    with pytest.raises(pd.CaseError, match="another Young's modulus in every direction"):
        pd.prepare(strip(reinforced((0.6, 0.8)), damage=damage))
    assert pd.prepare(strip(pd.Hyperelastic(NEO, mu=1.0, lam=2.0), damage=damage)).problem.damage is not None


def test_a_state_without_a_thickness_is_inadmissible():
    """The energy levels off so far that its derivative is zero in doubles: no thickness has no stress."""
    level = pd.Hyperelastic("a*(1 - exp(-(I1 - 3 - 2*log(J))))", "stress", a=1.0)
    problem = pd.prepare(strip(level)).problem
    x = problem.body.cloud.x[: problem.body.cloud.n_owned]
    assert problem.admissible(problem.state(0.1 * x))
    assert not problem.admissible(problem.state(30.0 * x))


GENT = "-mu/2*Jm*log(1 - (I1 - 3)/Jm) - mu*log(J) + lam/2*log(J)**2"
LOCKING = {
    "strain": GENT,
    "stress": "mu/2*(Jm/(1 - (I1 - 3)/Jm)) - mu*log(J) + lam/2*log(J)**2",
    "solid": "mu*Jm*(l1**2 + l2**2 + l3**2 - 3)/(Jm + 3 - l1**2 - l2**2 - l3**2)/2 - mu*log(J) + lam/2*log(J)**2",
}


@pytest.mark.parametrize("kind", LOCKING)
def test_no_strain_is_taken_beyond_that_at_which_a_chain_is_straight(kind):
    """Beyond it the derivatives of these energies are finite again, those of Gent's with the other sign."""
    dim, limit = 3 if kind == "solid" else 2, 2.0
    law = pd.Hyperelastic(LOCKING[kind], "stress" if kind == "stress" else "strain", mu=1.0, lam=2.0, Jm=limit)
    for stretch in (1.1, 1.5, 1.6, 2.2, 3.0):
        F = np.diag([stretch, 1.0 / stretch, 1.0])[None, :dim, :dim]
        across = law.hidden_stretch(F, np.empty((1, 0)))[0] if kind == "stress" else 1.0
        left = limit - (stretch**2 + 1.0 / stretch**2 + across**2 - 3.0)
        assert law.defined(F, np.zeros(1, dtype=np.int64), np.empty((1, 0))) == (left > 0.0)


def test_a_body_is_not_pulled_past_straight_chains(tmp_path):
    case = strip(pd.Hyperelastic(GENT, mu=1.0, lam=2.0, Jm=2.0))
    x = pd.prepare(case).problem
    position = x.body.cloud.x[: x.body.cloud.n_owned]
    assert x.admissible(x.state(0.5 * position * [1.0, -0.5]))
    assert not x.admissible(x.state(1.5 * position * [1.0, -0.4]))


@pytest.mark.parametrize("text", ["mu/2*(I1 - 3 - 2*log(J)) + mu*(log(I1 - 5) + (I1 - 3)/2)/9 + mu*(J - 1)**2"])
@pytest.mark.parametrize("named", [False, True])
def test_a_logarithm_of_a_negative_number_is_no_energy(text, named):
    with pytest.raises(pd.CaseError, match="no finite number at F = I"):
        pd.Hyperelastic(text.replace("5", "c") if named else text, mu=1.0, **({"c": 5.0} if named else {}))


CHILD = """
import sys
import numpy as np, pdpetsc as pd
assert "sympy" not in sys.modules
from tests.material.test_material import Law
law = Law(pd.Hyperelastic("mu/2*(I1 - 3 - 2*log(J)) + lam/3*(J - 1)**2", mu=1.0, lam=2.0), 3, 1)
print(law.stress(1.2 * np.eye(3)[None])[0, 0, 0])
"""


@pytest.mark.long
def test_machine_code_is_kept_and_not_needed(tmp_path):
    """A second process finds it; where no folder can be written to, the answer is the same."""

    def child(folder):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder), "PYTHONPATH": str(ROOT)}
        return subprocess.run(
            [sys.executable, "-c", CHILD], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
        ).stdout

    first = child(tmp_path)
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("energy_*") if path.is_file()}
    assert any(path.suffix == ".nbc" for path in kept)
    assert child(tmp_path) == first
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("energy_*") if path.is_file()} == kept
    assert child("/proc/nowhere") == first


ONE_RANK_ALONE = """
import sys
import pdpetsc as pd
from tests.material.test_hyperelastic import reinforced, strip, turning

def wrong(x):
    a = turning(x)
    a[x[:, 0] > 7.0] *= 2.0
    return a

try:
    pd.prepare(strip(reinforced(wrong)))
except pd.CaseError as error:
    print(f"refused: {error}", flush=True)
pd.run(strip(reinforced(turning)), output=sys.argv[1])
"""


def test_ranks_agree_on_fibres_by_place_and_on_what_is_wrong_on_one(tmp_path):
    alone = pd.run(strip(reinforced(turning)), output=tmp_path / "alone")["force"]
    said = script_on(2, ONE_RANK_ALONE, tmp_path / "two")
    assert said.count("of length 2; it must be a unit vector.") == 2
    together = summary(tmp_path / "two")["results"]["force"]
    assert together == pytest.approx(alone, rel=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("test", ["uniaxial", "equibiaxial"])
def test_rubber_has_the_stress_of_the_incompressible_law(test, tmp_path):
    """A sheet at stretch 5; the error of a finite bulk modulus falls as one over it."""
    words = (f"test={test}", "dim=2", "steps=10")
    soft, hard = (
        results("runs/solids/rubber.py", *words, f"kappa={k}", output=tmp_path / k)["results"] for k in ("1e4", "1e5")
    )
    assert hard["error"] < {"uniaxial": 5e-5, "equibiaxial": 2e-4}[test]
    assert soft["error"] / hard["error"] == pytest.approx(10.0, rel=0.02)
