"""What a case declares is right, or one sentence says what is wrong."""

import dataclasses
import inspect
import math
import os
import pwd
import resource
import signal
from pathlib import Path

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.case import check_declared
from pdpetsc.declare.influence import evaluate
from pdpetsc.declared import Declared
from pdpetsc.discrete import memory
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.families import find_families
from pdpetsc.discrete.memory import predicted_bonds, refuse_beyond_memory
from pdpetsc.kernels import compile as compiling
from pdpetsc.material import energy_loops
from pdpetsc.output.fingerprint import fingerprint
from pdpetsc.running.build import make_cloud
from tests.commands import called, script_on
from tests.commands import results as results_of

region = pd.region
LATTICE = pd.Lattice((0.0, 0.0), (4.0, 4.0), 1.0)
CRITICAL = pd.ConstantCritical(0.1)


def ones(x, *_):
    return np.ones(len(x))


def case(**changes):
    valid = {"particles": LATTICE, "horizon": 2.015, "material": pd.Hencky(1.0, 0.3), "conditions": []}
    return pd.Case(**{**valid, **changes})


# One valid object of everything that a case can declare.
VALID = [
    case(),
    pd.AdaptiveSteps(), pd.Steps(), pd.Table([0.0, 1.0], [0.0, 1.0]), pd.Cell((0.0, 0.0), (4.0, 4.0)),
    pd.Symmetry("x"), pd.Horizon(3.015), pd.Expected(1.0, relative=0.1, source="here"), pd.Units("mm", "N"),
    pd.DynamicRelaxation(), pd.EventDriven(), pd.PathFollowing(), pd.BondStretch(),
    pd.Opening("x", region.All(), step=0.1, end=1.0),
    pd.Dissipation(step=0.1),
    pd.Segment((0.0, 0.0), (1.0, 0.0)), pd.Polyline([(0.0, 0.0), (1.0, 0.0)]), pd.PlaneCrack((0.0,), (1.0,)),
    pd.Disc((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0),
    pd.PolygonCrack([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]),
    region.Box((0.0, 0.0), (1.0, 1.0)), region.Slab("x", 0.0, 1.0), region.Sphere((0.0, 0.0), 1.0),
    region.Nearest((0.0, 0.0)), region.Where(ones), region.Named("a"), region.All() | region.All(),
    region.Face("-x"),
    region.All() & region.All(), ~region.All(),
    pd.influence.Gaussian(), pd.Mesh("a.msh"), pd.MeshNodes("a.msh"), pd.TextFile("a.txt", {"left": "b.txt"}),
    pd.Mean(pd.stress, "xx"), pd.Largest(pd.stress, "xx"), pd.Smallest(pd.stress, "xx"),
    pd.OnSurface(pd.stress, "xx"), pd.Reaction("x"), pd.CellStrain("xx"), pd.CellStress("xx"),
    pd.JIntegral((2.0, 2.0), (1.0, 0.0), 1.0, 2.0), pd.EnergyReleaseRate((2.0, 2.0), (1.0, 0.0), 1.0, 2.0),
    pd.StressIntensity((2.0, 2.0), (1.0, 0.0), 1.0, 2.0), pd.CrackOpening((0.0, 2.0), (2.0, 2.0)), pd.CrackLength(),
    pd.CrackTip((1.0, 0.0)), pd.RelativeError(pd.stress, ones), pd.LargestError(pd.stress, ones), pd.Picture(),
    pd.Graded(pd.Hencky(1.0, 0.0), ones), pd.Thermal(pd.Hencky(1.0, 0.0), 1e-5), pd.Temperature(region.All(), 1.0),
    pd.Clamp(region.All()), pd.Roller(region.All(), "x"), pd.PointSupport(region.All(), x=0.0),
    pd.RigidPlane((0.0, 0.0), (0.0, 1.0)), pd.RigidSphere((0.0, 0.0), 1.0), pd.RigidBox((0.0, 0.0), (1.0, 1.0)),
    pd.RigidSurface([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]), pd.RigidRegion("-x"), pd.FollowerPressure(region.All(), 1.0),
    pd.CrackPressure(region.All(), 1.0),
    pd.ReactionMoment("-x", (0.0, 0.0)), pd.ArcLength(0.1, 1.0), pd.Centrifugal(region.All(), 1.0, (0.0,)), pd.Modes(2),
    pd.FrequencyResponse([1.0], ratio=0.1),
    pd.RigidCylinder((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 1.0), pd.Contact(region.All(), pd.RigidSphere((0.0, 0.0), 1.0)),
    pd.Bodies({"a": pd.LatticeNodes((0.0, 0.0), (1.0, 1.0), 0.5)}), pd.BodyContact("a +y", "b -y"),
    pd.ParticleContact(), pd.Tied("a", "b"),
    pd.HeatConduction(), pd.HeatFlux(region.All(), 1.0), pd.HeatSource(region.All(), 1.0),
    pd.Convection(region.All(), 1.0, 1.0),
    pd.Eigenstrain(region.All(), xx=0.1), pd.Hencky(1.0, 0.3), pd.NeoHookean(1.0, 0), pd.SaintVenantKirchhoff(1.0, 0),
    pd.Hyperelastic("mu/2*(I1 - 3 - 2*log(J)) + lam/2*log(J)**2 + k*(I4 - 1)**2", fibre=(1.0,), mu=1.0, lam=1.0, k=1.0),
    pd.MooneyRivlin(0.3, 0.1, 5.0), pd.Yeoh(0.3, 0.1, 0.1, 5.0), pd.Ogden((0.6, 0.1), (1.3, 5.0), 5.0),
    pd.HolzapfelGasserOgden(1.0, 1.0, 1.0, 5.0, (1.0, 0.0), dispersion=0.1),
    pd.Orthotropic((3.0, 2.0, 1.0), (0.1, 0.1, 0.1), (1.0, 1.0, 1.0), 0.3),
    pd.AnisotropicElastic(np.eye(6).tolist(), [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    pd.hardening.Linear(1.0), pd.hardening.Voce(1.0, 2.0), pd.hardening.Power(1.0, 0.5, 0.1),
    pd.hardening.Tabular([0.0, 0.1], [0.0, 1.0]), pd.hardening.Sum([pd.hardening.Linear(1.0)]),
    pd.rate.Perzyna(1.0, 1.0, 1.0), pd.rate.JohnsonCook(1.0, 0.1, 1.0, 500.0),
    pd.DruckerPrager(1.0, 0.3, cohesion=0.1, friction=0.5, dilatancy=0.1),
    pd.KinematicJ2(1.0, 0.3, yield_stress=0.1, kinematic=0.1), pd.Maxwell(1.0, 0.3, shear=[0.5], times=[2.0]),
    pd.LinearElastic(1.0, nu=0.0), pd.J2(1.0, 0.3, yield_stress=0.1), pd.BondBased(1.0), pd.LinearSolid(1.0, 0.2),
    CRITICAL, pd.LinearCritical(0.1, 0.2, 1.0), pd.CriticalFunction(ones), pd.FractureEnergy(1.0),
    pd.BondEnergy(w=1.0), pd.BondEnergy(Gc=1.0), pd.MazarsStrain(0.1), pd.VonMisesStrain(0.1), pd.PrincipalStress(1.0),
    pd.PlasticStrain(0.1), pd.JohnsonCookFailure(0.1, 1.0, -1.0, D4=0.1, D5=0.1, duration=1.0, melting=900.0),
    pd.DamageOf({"all": region.All()}, {"all": pd.Brittle(CRITICAL)}),
    pd.Brittle(CRITICAL), pd.LinearSoftening(CRITICAL), pd.ExponentialSoftening(CRITICAL),
    pd.BilinearSoftening(CRITICAL), pd.SmoothDegradation(CRITICAL),
    pd.PointDamage(pd.softening.Exponential(), Gc=1.0, strength=1.0),
    pd.softening.Bilinear(), pd.softening.Cornelissen(),
    pd.Correspondence(), pd.SubHorizons(), pd.StressPoints(), pd.Corrected(), pd.HigherOrder(), pd.BondAssociated(),
    pd.LatticeNodes((0.0, 0.0), (1.0, 1.0), 0.5),
    pd.Lattice((0.0, 0.0), (1.0, 1.0), 0.5), pd.Arrays([[0.0], [1.0]], [1.0, 1.0], {"a": [0]}),
    pd.Displacement(region.All(), x=0.0), pd.InitialVelocity(region.All(), x=0.0), pd.Velocity("-x", x=1.0),
    pd.Acceleration("-x", x=1.0),
    pd.RayleighDamping(mass=1.0),
    pd.AbsorbingBoundary("+x"), pd.Explicit(end=1.0), pd.Implicit(dt=0.5, end=1.0), pd.CrackSpeed((1.0, 0.0)),
    pd.SnapThrough(dt=0.5, end=1.0), pd.Foundation("-y", normal=1.0), pd.BulkViscosity(),
    pd.Force(region.All(), x=0.0), pd.BodyForce(region.All(), x=ones),
    pd.Traction(region.All(), x=0.0, normal=(1.0, 0.0)), pd.SurfacePressure(region.All(), 1.0),
    pd.Facets([[0.0], [2.0]], [[-1.0], [1.0]], [0, 1], {"left": [True, False]}),
    pd.MeanStrain(xx=0.1), pd.MeanStress(xx=1.0),
    pd.Silling(), pd.SillingMicromodulus(0.1, 1.0), pd.Littlewood(), pd.Wan(), pd.Springs(0.1),
    pd.AveragedDisplacement(0.1), pd.RelativeSprings(), pd.RelativeAverage(), pd.Penalty(0.1),
    pd.TangentScaled(pd.Silling()), pd.ByShear(pd.Silling()), pd.MeanDilatation(pd.SubHorizons(), 1.0),
    pd.SmoothedDisplacement(), pd.Standard(), pd.Conforming(),
]  # fmt: skip
WRONG = [
    None, "", "x", "xy", b"x", math.nan, math.inf, -math.inf, -1, 0, 1, 0.5, 1e300, 10**400, True, 1j, [], {}, (),
    [None], ["x"], {"x": None}, {1: 2}, {"x": "y"}, [[]], [math.nan, 1.0], object(), object, pd.EventDriven, pd.Hencky,
    region.All, region.All(), pd.stress, np.array(1.0), np.array([1.0, np.nan]), np.int64(2), np.float32(0.5),
    np.array(["x"]), lambda: None, iter(()), {1.0}, [region.All()], [(region.All(), 1)], range(3),
]  # fmt: skip


def test_every_declared_class_is_in_the_list():
    listed = {type(value) for value in VALID}
    missing = [
        kind.__name__
        for kind in vars(pd).values()
        if inspect.isclass(kind) and issubclass(kind, Declared) and not inspect.isabstract(kind)
        and dataclasses.is_dataclass(kind) and dataclasses.fields(kind) and kind not in listed
    ]  # fmt: skip
    assert not missing


@pytest.mark.parametrize("valid", VALID, ids=lambda v: type(v).__name__)
def test_wrong_values_are_refused_in_one_sentence(valid, rng):
    fields = [field.name for field in dataclasses.fields(valid) if field.init]
    for name in fields:
        for value in WRONG:
            refused(valid, {name: value})
    for _ in range(100 if fields else 0):
        chosen = rng.choice(fields, size=min(2, len(fields)), replace=False)
        refused(valid, {name: WRONG[rng.integers(len(WRONG))] for name in chosen})


def refused(valid, changes):
    try:
        dataclasses.replace(valid, **changes)
    except pd.CaseError as error:
        text = str(error)
        assert text.endswith(".") and "\n" not in text and len(text) < 600, text
        return True
    except Exception as error:
        raise AssertionError(f"{type(valid).__name__} with {changes}: {error!r}") from error
    return False


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: case(solver="newton"), "takes a Newton, .* as solver, not 'newton'"),
        (lambda: case(solver=pd.EventDriven), r"not the class EventDriven; write EventDriven\(...\)"),
        (lambda: case(conditions=pd.Force(region.All(), x=1.0)), "as conditions, not Force.*; put it into a list"),
        (lambda: case(conditions=[pd.Force(region.All(), x=1.0), 3]), "entry 2 is 3"),
        (lambda: case(cracks=pd.Segment((0, 0), (1, 0))), "put it into a list"),
        (lambda: case(horizon="2"), "takes a number, a Horizon, a function, an array or None as horizon, not '2'"),
        (lambda: case(options={3: 1}), "mapping of strings"),
        (lambda: case(options={"-ksp_type": "cg"}), "one word without dash"),
        (lambda: case(options={"ksp_type": [1]}), "takes a string, a number or None"),
        (lambda: case(material=[]), "at least one material"),
        (
            lambda: case(history={"u": pd.stress}),
            r"as history, not .*; 'u' is the function stress; wrap the function f as pd.Mean\(f\), pd.Largest\(f\) or",
        ),
        (lambda: case(history={"E": pd.StrainEnergy}), r"; 'E' is the class StrainEnergy; write StrainEnergy\(...\)"),
        (lambda: pd.OnSurface(pd.stress, "xx", take="least"), "'mean' or 'largest' or 'smallest' as take, not 'least'"),
        (lambda: case(history={"a,b": pd.StrainEnergy()}), "without commas"),
        (lambda: case(history={"a\nb": pd.StrainEnergy()}), "cannot be named"),
        (lambda: case(history={"step": pd.StrainEnergy()}), "named 'step'"),
        (lambda: case(fields=[lambda s: s.u, lambda s: s.u]), "Define it with def, or give fields="),
        (lambda: case(fields=[pd.stress, pd.stress]), "Two fields are named 'stress'"),
        (lambda: case(fields={"stress": pd.displacement}, picture=pd.Picture()), "Two fields are named 'stress'"),
        (lambda: case(fields={"a b": pd.stress}), "no name for files"),
        (lambda: case(fields={"volume": pd.stress}), "named 'volume'"),
        (lambda: pd.Lattice((4.0, 0.0), (0.0, 4.0), 1.0), "low of the Lattice is above high along x. Exchange low and"),
        (lambda: pd.Steps(10**9), "whole number up to 99999, not"),
        (lambda: pd.AdaptiveSteps(1e-8, 1e-8, 1e-8), "at least 1/99999"),
        (lambda: pd.AdaptiveSteps(1e-9, 1e-9), "1e-08 <= smallest"),
        (lambda: pd.Steps(2.0), "a whole number as count"),
        (lambda: pd.Steps(2, bonds_at_once=0), "a positive whole number or None as bonds_at_once, not 0"),
        (lambda: pd.PathFollowing(bonds_at_once=0), "a positive whole number or None as bonds_at_once, not 0"),
        (lambda: pd.Corrected(1000), "between 1 and 12"),
        (lambda: pd.HigherOrder(1000), "between 1 and 12"),
        (lambda: pd.SubHorizons(10**9), "between 2 and 256"),
        (lambda: pd.Pressure("+x", 1.0, normal=(1.0, 0.0, 0.0, 0.0)), r"three numbers, not \(1.0, 0.0, 0.0, 0.0\)"),
        (lambda: pd.Pressure("+x", 1.0, normal="+x"), "A Pressure needs an outward normal of up to three numbers"),
        (lambda: pd.Pressure("+x", 1.0, normal=1.0), "of up to three numbers, not 1.0"),
        (lambda: region.Slab(""), "'x' or 'y' or 'z' as axis, not ''"),
        (lambda: region.Slab("xy"), "as axis, not 'xy'"),
        (lambda: region.Box((0.0, math.nan), (1.0, 1.0)), "entry 2 is nan"),
        (lambda: region.Sphere((0.0, 0.0), math.nan), "not nan"),
        (lambda: region.All() | 3, "Union takes a Region as other, not 3"),
        (lambda: pd.Table([0.0, 1.0], [0.0, math.nan]), "entry 2 is nan"),
        (lambda: pd.Table([0.0, 1.0], [0.0, math.inf]), "finite numbers"),
        (lambda: pd.MeanStress(xx=math.inf), "a finite number or None as xx, not inf"),
        (lambda: pd.Displacement(region.All(), y=-math.inf), "a finite number, a function or None as y, not -inf"),
        (lambda: pd.Eigenstrain(region.All(), zz=math.inf), "a finite number as zz, not inf"),
        (lambda: pd.Eigenstrain(region.All()), "at least one component that is not zero"),
        (lambda: pd.Steps(plastic_growth=0.0), "a positive number or None as plastic_growth, not 0.0"),
        (lambda: pd.Opening("x", region.All(), step=1.0, end=-1.0), "a positive number as end, not -1.0"),
        (lambda: pd.TextFile("cloud.txt", dim=4), "1 or 2 or 3 or None as dim, not 4"),
        (lambda: pd.TextFile("cloud.txt", dim="2"), "1 or 2 or 3 or None as dim, not '2'"),
        (lambda: pd.Graded("steel", ones), "a Material or a BondMaterial as material"),
        (lambda: pd.Picture(pd.displacement, "xx"), "A Picture of displacement requires one of x, y, z as component"),
        (lambda: pd.Picture(pd.local_damage, "x"), "requires no letter as component"),
        (lambda: pd.Mean(pd.stress, "w"), "^A Mean of stress requires two of x, y, z as component, not 'w'"),
    ],
)  # fmt: skip
def test_what_is_wrong_and_where(make, message):
    with pytest.raises(pd.CaseError, match=message):
        make()


def test_whole_numbers_of_any_kind_and_fields_by_name_are_taken():
    assert pd.Steps(np.int64(2)).stops() == [0.5, 1.0]
    assert [f.__name__ for f in case(fields={"a": lambda s: s.u, "b": pd.stress}).written] == ["a", "b"]
    own = case(fields={"displacement": pd.displacement, "stress": pd.stress}, picture=pd.Picture())
    assert own.written == [pd.displacement, pd.stress]
    assert refused(pd.Steps(), {"count": True})


def test_components_that_the_body_lacks():
    box = region.Box((0.0,) * 3, (1.0,) * 3)
    check_declared(case(picture=pd.Picture(), history={"u": pd.Mean(pd.displacement, "y")}), 2)
    for changes, message in (
        (
            {"picture": pd.Picture(pd.stress, "zz")},
            "A Picture of stress in 2D requires two of x, y as component, not 'zz'",
        ),
        ({"history": {"u": pd.Mean(pd.displacement, "z")}}, "'u' of the history: .* in 2D"),
        ({"history": {"u": pd.Reaction("z")}}, "in 2D"),
        ({"history": {"tip": pd.CrackTip((1.0, 0.0, 0.0))}}, "has 2 numbers"),
        ({"solver": pd.PathFollowing(pd.Opening("z", region.All(), step=1.0, end=1.0))}, "component z"),
        ({"history": {"u": pd.Mean(pd.stress, "xx", box)}}, "'u' of the history: The low corner of Box needs 2"),
        ({"history": {"u": pd.LargestError(pd.stress, ones, ~box)}}, "'u' of the history: The low corner of Box needs"),
        ({"conditions": [pd.Displacement(box | region.All(), x=0.0)]}, "Displacement condition 1: The low corner"),
        ({"material": [(region.All() & box, pd.Hencky(1.0, nu=0.0))]}, "Material 1: The low corner"),
        ({"conditions": [pd.Force(region.Slab("z"), x=0.0)]}, "Force condition 1: Slab axis 'z' is not one of"),
        ({"conditions": [pd.Force(region.Sphere(0.0, 1.0), x=0.0)]}, "centre of Sphere needs 2 coordinates"),
        ({"conditions": [pd.Force(region.Nearest(0.0), x=0.0)]}, "point of Nearest needs 2 coordinates"),
        ({"cell": pd.Cell((0.0,), (1.0,))}, "The Cell has 1 coordinates, the particles 2"),
    ):
        with pytest.raises(pd.CaseError, match=message):
            check_declared(case(**changes), 2)


def test_fields_by_name_are_written_under_their_names(tmp_path):
    import h5py

    fields = {"twice": lambda s: 2.0 * s.u, "place": lambda s: s.x}
    held = pd.Displacement(region.All(), x=0.5, y=0.0)
    pd.run(case(conditions=[held], fields=fields), output=tmp_path)
    with h5py.File(tmp_path / "fields.h5") as file:
        last = file[max(name for name in file if name.startswith("step"))]
        assert set(last) == {"twice", "place"}
        assert np.allclose(last["twice"][:, 0], 1.0)


def test_functions_that_take_other_arguments_are_refused_before_a_run(tmp_path):
    def nothing():
        return {}

    class Number(pd.Quantity):
        def evaluate(self):
            return 1.0

    for changes, message in (
        ({"results": nothing}, r"results nothing\(\) cannot be called with \(history\): too many positional"),
        ({"fields": [nothing]}, r"field nothing\(\) cannot be called with \(solution\)"),
        ({"fields": {"a": nothing}}, r"cannot be called with \(solution\)"),
        ({"history": {"a": Number()}}, "The quantity 'a' of the history evaluate"),
    ):
        with pytest.raises(pd.CaseError, match=message):
            case(**changes)
    assert case(results=min, fields={"a": np.negative}).results is min
    path = tmp_path / "case.py"
    path.write_text("case = min\n")
    finished = called(path)
    assert finished.returncode == 2
    assert finished.stderr.count("\n") == 1
    assert "The case <built-in function min> is no function" in finished.stderr


def test_a_pipe_is_no_file_of_particles(tmp_path):
    pipe, whole = tmp_path / "pipe.txt", tmp_path / "cloud.txt"
    os.mkfifo(pipe)
    whole.write_text("0 0 1 1\n1 0 1 1\n")

    def late(number, frame):
        raise AssertionError("it waits for a writer")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(20)
    try:
        for particles in (pd.TextFile(pipe), pd.TextFile(whole, {"left": pipe}), pd.Mesh(pipe, format="xdmf")):
            with pytest.raises(pd.CaseError, match=r"pipe or a device|file not found"):
                particles.chunk(0, 1)
            fingerprint(particles)
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def test_a_strain_energy_needs_no_home(monkeypatch):
    def nobody(uid):
        raise KeyError(f"getpwuid(): uid not found: {uid}")

    for name in ("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(pwd, "getpwuid", nobody)
    monkeypatch.setattr(energy_loops, "__file__", "/proc/nowhere/energy_loops.py")
    monkeypatch.setattr(compiling, "_trouble", [])  # what this process could not cache is this test's alone
    assert energy_loops._module("number = 0.731\n").number == 0.731


# --- functions of the user


def test_errors_of_functions_have_their_name_and_line(tmp_path):
    def wrong(x, *_):
        return undefined_name  # noqa: F821

    body = case(conditions=[pd.Displacement(region.Where(wrong), x=0.0, y=0.0)])
    for made in (
        body,
        case(material=pd.Graded(pd.Hencky(1.0, 0.3), wrong)),
        case(particles=pd.Lattice((0.0, 0.0), (4.0, 4.0), 1.0, cut=region.Where(wrong))),
        case(material=pd.BondBased(1.0), damage=pd.Brittle(pd.CriticalFunction(wrong))),
        case(influence=type("Own", (pd.influence.Influence,), {"__call__": lambda self, s: wrong(s)})()),
    ):
        with pytest.raises(pd.CaseError, match=r"failed at test_input.py:\d+: NameError: .*undefined_name"):
            pd.run(made, output=tmp_path)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda s: "x", "must return real numbers, not 'x'"),
        (lambda s: 1.0, "one number per bond"),
        (lambda s: np.where(s < 0.5, 1.0, np.nan), "The influence is nan at"),
        (lambda s: 0.6 - s, "it must not be negative"),
    ],
)
def test_influence_functions_return_numbers(function, message):
    own = type("Own", (pd.influence.Influence,), {"__call__": lambda self, s: function(s)})()
    with pytest.raises(pd.CaseError, match=message):
        evaluate(own, np.linspace(0.1, 1.0, 10))


ON_ONE_RANK = """
import numpy as np
import pdpetsc as pd

def odd(x):
    if x[:, 0].min() > 3.0:
        {fault}
    return np.ones(len(x), dtype=bool)

def case():
    R = pd.region
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (8.0, 2.0), 1.0), horizon=1.5, material=pd.BondBased(E=1.0),
        conditions=[pd.Displacement(({region}), x=0.0, y=0.0)],
    )
"""


OF_RANKS = """
import numpy as np
import pdpetsc as pd
from mpi4py import MPI

RANK = MPI.COMM_WORLD.rank
NOISE = np.random.default_rng(RANK).random()
ALL = pd.region.All()


class Load:
    def __init__(self, size):
        self.size, self.rank = size, RANK

    def __call__(self, x, t):
        return self.size * t * np.ones(len(x))


def loose(x, t):
    return NOISE * t * np.ones(len(x))


def said(x, t):
    return np.full(len(x), 0.1 * t) if RANK < 9 else None


def drawn(random):
    return lambda x, t: random.random(len(x))


def case(**changes):
    valid = {
        "particles": pd.Lattice((0.0, 0.0), (4.0, 4.0), 1.0), "horizon": 2.015, "material": pd.Hencky(1.0, 0.3),
        "conditions": [pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0, y=0.0)],
    }
    return pd.Case(**{**valid, **changes})


def pulled(x):
    return case(conditions=[pd.Displacement(ALL, y=0.0), pd.Displacement(ALL, x=x)])


def cloud(seed):
    return pd.Arrays(4.0 * np.random.default_rng(seed).random((20, 2)), np.ones(20))


TWO = [pd.StrainEnergy(), pd.ExternalWork()]
DIFFERING = {
    "`material.E` differs between ranks: 1.0 on rank 0, 2.0 on rank 1": lambda: case(material=pd.Hencky(1.0 + RANK, 0)),
    "`particles.x` differs": lambda: case(particles=cloud(RANK)),
    "`conditions[1].x` differs between ranks: 0.0 on": lambda: pulled(0.1 * RANK),
    "`conditions[1].x.size` differs": lambda: pulled(Load(NOISE)),
    "`NOISE` of `conditions[1].x` differs": lambda: pulled(loose),
    "`random` of `conditions[1].x` differs": lambda: pulled(drawn(np.random.default_rng(RANK))),
    "`conditions` differs between ranks: 1 entries on": lambda: case(conditions=case().conditions * (RANK + 1)),
    "`steps.count` differs between ranks: 5 on": lambda: case(steps=pd.Steps(5 + RANK)),
    "`steps` differs between ranks: Steps(count=5": lambda: case(steps=pd.AdaptiveSteps() if RANK else pd.Steps(5)),
    "`history` differs between ranks: {} on": lambda: case(history={"E": TWO[0]} if RANK else {}),
    "`history` differs between ranks: {'0'": lambda: case(history={str((n + RANK) % 2): TWO[n] for n in range(2)}),
    "`fields` differs between ranks: 1 entries on": lambda: case(fields=[] if RANK else [pd.stress]),
    "`results` differs between ranks: None on": lambda: case(results=(lambda h: {}) if RANK else None),
    "`options['snes_rtol']` differs": lambda: case(options={"snes_rtol": 10.0 ** (-6 - RANK)}),
}
for words, make in DIFFERING.items():
    try:
        pd.prepare(make())
    except pd.CaseError as error:
        assert str(error).startswith(words) and "on rank 1; a case must be the same" in str(error), error
    else:
        raise AssertionError(f"nobody said: {words}")
try:
    pd.run(case(), "out", check=bool(RANK))
except pd.CaseError as error:
    assert str(error).startswith("`check` differs between ranks: False on rank 0"), error
# A function may know its rank, and particles of the same seed are the same.
for valid in (pulled(said), pulled(Load(1.0)), case(particles=cloud(1))):
    pd.prepare(valid)
"""


def test_a_case_that_differs_between_ranks_is_refused_with_the_value_that_differs():
    script_on(2, OF_RANKS, timeout=60.0)


def test_a_region_that_fails_on_one_rank_ends_all(tmp_path):
    scene = tmp_path / "scene.py"
    chosen = "R.Nearest((0.0, 0.0)) | R.Where(odd) & R.Nearest((9.0, 0.0))"
    scene.write_text(ON_ONE_RANK.format(fault="raise KeyError('a')", region=chosen))
    finished = called(scene, "-o", tmp_path / "out", ranks=2)
    assert finished.returncode == 2, finished.stderr
    assert "odd failed at scene.py:7: KeyError: 'a'" in finished.stderr
    assert "Traceback" not in finished.stderr
    assert finished.stderr.count("pdpetsc:") == 1


def test_a_region_that_gives_no_mask_is_refused(tmp_path):
    own = type("Own", (region.Region,), {"mask": lambda self, view: view.x[:, 0]})()
    with pytest.raises(pd.CaseError, match=r"condition 1 must give .* bool, not .* float64"):
        pd.run(case(conditions=[pd.Displacement(own, x=0.0)]), output=tmp_path)


def test_nearest_is_nearest_on_any_rank_count(tmp_path):
    scene = tmp_path / "scene.py"
    chosen = "R.Nearest((0.6, 0.6)) | R.Nearest((7.4, 1.4)) & R.All()"
    text = ON_ONE_RANK.format(fault="pass", region=chosen)
    scene.write_text(text.replace("y=0.0)],", "y=0.0)], history={'u': pd.Largest(marked)},") + MARKED)
    results_of(scene, ranks=2, output=tmp_path / "out")
    assert (tmp_path / "out" / "history.csv").read_text().splitlines()[1].endswith(",2.0")


MARKED = """
def marked(solution):
    return np.full(len(solution.x), float(solution.sum(solution.problem.supports.fixed[:, 0].sum())))
"""


def test_references_have_the_shape_of_the_field_or_one_that_spreads(tmp_path):
    def size(x, t):
        return 0.5 * t * np.array([1.0, 0.0])

    held = pd.Displacement(region.All(), x=0.5, y=0.0)
    asked = {"relative": pd.RelativeError(pd.displacement, size), "largest": pd.LargestError(pd.displacement, size)}
    results = {}
    body = case(conditions=[held], history=asked, results=lambda h: results.update(h) or {})
    pd.run(body, output=tmp_path)
    assert results["relative"][1] == results["largest"][1] == 0.0
    # The body is at rest at the start.
    assert math.isnan(results["relative"][0])
    wrong = {"relative": pd.RelativeError(pd.displacement, lambda x, t: np.ones(7))}
    with pytest.raises(pd.CaseError, match=r"must return values of the shape of the field, \(16, 2\), not \(7,\)"):
        pd.run(case(conditions=[held], history=wrong), output=tmp_path)


@pytest.mark.parametrize("values", [1.0, "x", [1.0, 2.0], np.array(["x"] * 16), None])
def test_fields_of_another_shape_are_refused(tmp_path, values):
    def odd(solution):
        return values

    for quantity in (pd.Mean(odd), pd.Largest(odd), pd.LargestError(odd, ones)):
        body = case(conditions=[pd.Displacement(region.All(), x=0.5, y=0.0)], history={"a": quantity})
        with pytest.raises(pd.CaseError, match="The field odd must return numbers for each of 16 particles"):
            pd.run(body, output=tmp_path)


# --- endless work


def test_particles_and_families_that_no_machine_holds():
    huge = pd.Lattice((0.0,) * 3, (1e4,) * 3, 1.0, fictitious={"-x": 2.0})
    assert huge.estimate() == 10**12 + 2 * 10**8
    for body, message in (
        (case(particles=huge), "Making the particles takes at least .* GiB free"),
        (case(particles=pd.Lattice((0.0,), (1e5,), 1.0), horizon=1e300), "neighbours each, which takes at least"),
        (case(horizon=1e6, cell=pd.Cell((0.0, 0.0), (4.0, 4.0))), "images of the periodic cell"),
    ):
        with pytest.raises(pd.CaseError, match=message):
            make_cloud(world(), body)


def test_schemes_say_what_a_bond_takes(monkeypatch):
    monkeypatch.setattr(memory, "free_memory", lambda: 2.0e5)
    make_cloud(world(), case(material=pd.BondBased(1.0)))
    with pytest.raises(pd.CaseError, match="takes at least"):
        make_cloud(world(), case(scheme=pd.SubHorizons(100)))


@pytest.mark.parametrize(
    ("lattice", "horizon", "cell"),
    [
        (pd.Lattice((0.0,) * 2, (30.0,) * 2, 1.0), 3.015, None),
        (pd.Lattice((0.0,) * 3, (8.0,) * 3, 1.0), 2.015, pd.Cell((0.0,) * 3, (8.0,) * 3)),
        (pd.Lattice((0.0,) * 2, (8.0,) * 2, 1.0), 7.015, pd.Cell((0.0,) * 2, (8.0,) * 2)),
        (pd.Lattice((0.0,) * 2, (4.0, 40.0), 1.0), 7.015, pd.Cell((0.0,) * 2, (4.0, 40.0), "x")),
        (pd.Lattice((0.0,), (1.0,), 1.0), 40.0, pd.Cell((0.0,), (1.0,))),
    ],
)
def test_bonds_are_predicted(lattice, horizon, cell):
    cloud = make_cloud(world(), case(particles=lattice, horizon=horizon, cell=cell))
    predicted = predicted_bonds(world(), lattice.chunk(0, 1).x, horizon, cell)
    assert predicted == pytest.approx(len(find_families(cloud).neighbours), rel=0.15)


def test_free_memory_is_known_here():
    assert 2**20 < memory.free_memory() < 2**60
    refuse_beyond_memory(world(), 1.0, "A byte")


def test_images_of_a_small_cell_are_forecast_and_take_no_memory_among_themselves(monkeypatch):
    """16 particles at a horizon of 15 periods have 12,000 images, whose 50 million pairs are no bonds."""
    corners = (0.0, 0.0), (1.0, 1.0)
    small = case(particles=pd.Lattice(*corners, 0.25), cell=pd.Cell(*corners), horizon=15.0, material=pd.BondBased(1.0))
    taken = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmData"))
    before = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (1024 * int(taken.split()[1]) + 2**28, before[1]))
    try:
        cloud = make_cloud(world(), small)
        families = find_families(cloud)
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)
    points = np.arange(-16 * 4, 17 * 4) * 0.25
    apart = np.hypot(*np.meshgrid(points, points))
    assert families.n_bonds == 16 * (np.count_nonzero(apart <= 15.0) - 1)
    members = cloud.order[families.neighbours[families.indptr[0] : families.indptr[1]]]
    assert (np.diff(members) > 0).all()
    images = memory.predicted_images(world(), small.particles.chunk(0, 1).x, 15.0, small.cell)
    assert cloud.n_ghost < images < 1.5 * cloud.n_ghost
    monkeypatch.setattr(memory, "free_memory", lambda: 40.0 * families.n_bonds)
    with pytest.raises(pd.CaseError, match=r"takes at least .* GiB on a machine"):
        make_cloud(world(), small)


@pytest.mark.parametrize("material", [pd.Hencky(1.0, 0.3), pd.BondBased(1.0), pd.LinearSolid(1.0, 0.2)])
def test_a_single_particle_is_no_body(tmp_path, material):
    body = case(particles=pd.Lattice((0.0,), (2.0,), 2.0), material=material)
    with pytest.raises(
        pd.CaseError,
        match=r"No two of the 1 particles share a bond: the horizon is .*, the mean spacing 2. .* at least 2.03.",
    ):
        pd.run(body, output=tmp_path)
