"""What a run does over its life: steps, cut-backs, linear problems, restart, output, interruption, a full disk."""

import json
import os
import signal
import subprocess
import xml.etree.ElementTree as ET

import h5py
import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import ROOT, called, command, field, history, results, run, summary, wait_until

CLAMPED = ROOT / "runs/beams/clamped.py"


def strip(pull=0.3, **changes):
    """Return a strip of 10 x 4 particles pulled by a prescribed displacement."""
    declared = {
        "particles": pd.Lattice((0.0, 0.0), (10.0, 4.0), 1.0),
        "horizon": 2.015,
        "material": pd.Hencky(E=10.0, nu=0.3),
        "control": pd.Silling(0.5),
        "conditions": [
            pd.Displacement(pd.region.Slab("x", high=2.0), x=0.0, y=0.0),
            pd.Displacement(pd.region.Slab("x", low=8.0), x=pull, y=0.0),
        ],
        "history": {"force": pd.Reaction("x", pd.region.Slab("x", low=8.0)), "energy": pd.StrainEnergy()},
        "results": lambda h: {"force": h["force"][-1]},
    }
    return pd.Case(**(declared | changes))


def test_python_call_equals_the_command_line(tmp_path):
    found = pd.run(strip(), output=tmp_path)
    assert found == summary(tmp_path)["results"]
    assert found["force"] > 0.0


def test_options_of_a_run_do_not_outlive_it(tmp_path):
    pd.run(strip(), output=tmp_path, options={"ksp_type": "cg", "pc_type": "jacobi"})
    assert "ksp cg, pc jacobi" in summary(tmp_path)["solver"]
    pd.run(strip(), output=tmp_path)
    assert "ksp preonly, pc cholesky" in summary(tmp_path)["solver"]


def test_solvers_agree(tmp_path):
    forces = [
        pd.run(strip(), output=tmp_path, options=options)["force"]
        for options in (
            {},
            {"pc_type": "lu"},
            {"ksp_type": "cg", "pc_type": "gamg", "ksp_rtol": 1e-10},
            {"ksp_type": "gmres", "pc_type": "bjacobi", "ksp_rtol": 1e-10},
            {"snes_linesearch_type": "basic"},
        )
    ]
    assert np.ptp(forces) < 1e-8 * abs(forces[0])


def test_a_linear_problem_takes_one_factorisation_and_one_solve_a_step(tmp_path):
    case = strip(material=pd.LinearElastic(E=10.0, nu=0.3), steps=pd.Steps(3))
    pd.run(case, output=tmp_path, options={"log_view": None})
    steps = summary(tmp_path)["steps"]
    assert [step["linear_iterations"] for step in steps] == [1, 1, 1]
    force = np.loadtxt(tmp_path / "history.csv", delimiter=",", skiprows=1)[:, 2]
    assert np.allclose(force, force[-1] * np.array([0.0, 1.0, 2.0, 3.0]) / 3.0, rtol=1e-10)


def test_external_work_is_stored_and_what_is_not_is_dissipated(tmp_path):
    """Linear: exact. Finite strain: the trapezoidal rule converges with the square of the step."""
    energies = {"work": pd.ExternalWork(), "stored": pd.StrainEnergy(), "lost": pd.DissipatedEnergy()}
    energies["control"] = pd.ControlEnergy()

    def gap(**changes):
        pd.run(strip(history=energies, results=None, **changes), output=tmp_path)
        rows = history(tmp_path)
        assert np.all(rows["lost"] == 0.0)
        return abs(rows["work"][-1] - rows["stored"][-1] - rows["control"][-1]) / rows["work"][-1]

    assert gap(material=pd.LinearElastic(E=10.0, nu=0.3)) < 1e-12
    coarse, fine = (gap(steps=pd.Steps(n)) for n in (4, 8))
    assert fine == pytest.approx(coarse / 4.0, rel=0.1)


def test_work_of_the_load_is_the_energy(tmp_path):
    """Trapezoidal work of the prescribed displacement against stored energy of a hyperelastic body without control."""
    pd.run(strip(control=None, steps=pd.Steps(40)), output=tmp_path)
    _, t, force, energy = np.loadtxt(tmp_path / "history.csv", delimiter=",", skiprows=1).T
    work = 0.3 * np.diff(t) @ (0.5 * (force[1:] + force[:-1]))
    assert energy[-1] == pytest.approx(work, rel=1e-3)


def test_adaptive_steps_grow_and_end_at_the_full_load(tmp_path):
    pd.run(strip(steps=pd.AdaptiveSteps(first=0.05, largest=0.4)), output=tmp_path)
    t = [step["t"] for step in summary(tmp_path)["steps"]]
    sizes = np.diff([0.0, *t])
    assert t[-1] == 1.0
    assert len(t) < 10
    assert sizes[1] == pytest.approx(1.5 * sizes[0])
    assert sizes.max() <= 0.4 + 1e-12


def test_a_step_that_inverts_the_body_is_cut_back_until_the_smallest(tmp_path):
    """Squashed to nothing at half the load the strip must fail, with the converged steps on disk."""
    squash = pd.Displacement(pd.region.All(), x=lambda x, t: -2.0 * t * x[:, 0], y=0.0)
    case = strip(conditions=[squash], steps=pd.Steps(4, smallest=0.01))
    with pytest.raises(pd.SolveError, match=r"No convergence from step time .* the smallest step: .*residual"):
        pd.run(case, output=tmp_path)
    found = summary(tmp_path)
    assert found["status"].startswith("No convergence")
    assert found["failed_attempts"]
    rows = np.loadtxt(tmp_path / "history.csv", delimiter=",", skiprows=1, ndmin=2)
    assert len(rows) == 1 + len(found["steps"])
    with h5py.File(tmp_path / "fields.h5") as file:
        assert sum(name.startswith("step_") for name in file) == len(rows)


def test_a_run_with_few_checkpoints_keeps_the_step_that_it_ends_at(tmp_path):
    squash = pd.Displacement(pd.region.All(), x=lambda x, t: -2.0 * t * x[:, 0], y=0.0)
    case = strip(conditions=[squash], steps=pd.Steps(8, smallest=0.05), checkpoints=1000)
    with pytest.raises(pd.SolveError):
        pd.run(case, output=tmp_path)
    last = summary(tmp_path)["steps"][-1]
    with h5py.File(tmp_path / "checkpoint.h5") as file:
        head = json.loads(file.attrs["head"])
        assert (head["step"], head["t"]) == (last["step"], last["t"])
    pd.run(strip(checkpoints=0), output=tmp_path / "none")
    assert not (tmp_path / "none" / "checkpoint.h5").exists()
    with pytest.raises(pd.CaseError, match="checkpoints"):
        strip(checkpoints=-1)


@pytest.mark.parametrize("ranks", [2, pytest.param(1, marks=pytest.mark.long)])
def test_a_failed_run_ends_with_status_1_on_every_rank_count(ranks, tmp_path):
    finished = run(CLAMPED, "ny=3", "-snes_max_it", "1", ranks=ranks, output=tmp_path)
    assert finished.returncode == 1
    said = [line for line in finished.stderr.splitlines() if line.startswith("pdpetsc:")]
    assert len(said) == 1
    assert "too many Newton iterations, residual" in said[0]


def test_fields_are_what_xdmf_says(tmp_path):
    pd.run(strip(steps=pd.Steps(2)), output=tmp_path)
    grids = ET.parse(tmp_path / "fields.xdmf").getroot().findall(".//Grid[@GridType='Uniform']")
    assert [float(grid.find("Time").get("Value")) for grid in grids] == [0.0, 0.5, 1.0]
    with h5py.File(tmp_path / "fields.h5") as file:
        for grid in grids:
            names = [attribute.get("Name") for attribute in grid.findall("Attribute")]
            entries = [f"stress_{entry}" for entry in ("xx", "xy", "yx", "yy", "zz")]
            assert names == ["volume", "displacement", "stress", *entries, "von_mises"]
            for item in grid.iter("DataItem"):
                name, path = item.text.split(":")
                assert name.startswith("fields/")
                with h5py.File(tmp_path / name) as one:
                    assert list(one[path].shape) == [int(n) for n in item.get("Dimensions").split()]
                    assert np.array_equal(one[path], file[f"{one.filename.split('/')[-1][:-3]}{path}"])


def test_user_fields_and_a_scene_without_fields(tmp_path):
    def radius(solution):
        return np.linalg.norm(solution.x + solution.u, axis=1)

    pd.run(strip(fields=[radius]), output=tmp_path / "a")
    x = field(tmp_path / "a", "radius")
    assert x.shape == (40,)
    pd.run(strip(fields=[]), output=tmp_path / "b")
    assert not (tmp_path / "b" / "fields.h5").exists()


def test_a_bare_scene_allocates_less_than_a_full_one(tmp_path):
    pd.run(strip(control=None), output=tmp_path / "bare")
    pd.run(strip(), output=tmp_path / "full")
    bare, full = summary(tmp_path / "bare")["allocated"], summary(tmp_path / "full")["allocated"]
    assert set(bare) < set(full)
    assert [name for name in full if name not in bare] == ["control Silling"]


HALF = """
import dataclasses, sys
sys.path.insert(0, {folder!r})
import clamped
import pdpetsc as pd

class Stop(pd.Quantity):
    def evaluate(self, solution):
        if solution.t > 0.6:
            raise pd.Interrupted("enough")
        return pd.StrainEnergy().evaluate(solution)

def case({words}):
    whole = clamped.case({names})
    return dataclasses.replace(whole, history={{**whole.history, "energy": Stop()}})
"""


def half(folder, *arguments, ranks=1):
    """Run the clamped beam up to half its load; the columns of its history are those of the whole run."""
    names = [word.split("=")[0] for word in arguments]
    text = HALF.format(
        folder=str(CLAMPED.parent), words=", ".join(arguments), names=", ".join(f"{n}={n}" for n in names)
    )
    path = folder.with_suffix(".py")
    path.write_text(text)
    stopped = called(path, "--quiet", "-o", folder, ranks=ranks)
    assert stopped.returncode == 1, stopped.stderr


@pytest.mark.parametrize("ranks", [1, pytest.param(3, marks=pytest.mark.long)])
def test_restart_continues_to_the_same_fields(ranks, tmp_path):
    arguments = ("ny=3", "horizon=2.015", "G=0.5", "steps=4")
    results(CLAMPED, *arguments, output=tmp_path / "whole")
    half(tmp_path / "part", *arguments, ranks=2)
    results(CLAMPED, *arguments, "--restart", tmp_path / "part", output=tmp_path / "rest", ranks=ranks)
    one, other = field(tmp_path / "whole", "displacement"), field(tmp_path / "rest", "displacement")
    assert np.abs(one - other).max() <= 1e-10 * np.abs(one).max()


@pytest.mark.parametrize("ranks", [pytest.param(1, marks=pytest.mark.long), 2])
def test_restart_in_its_own_folder_keeps_what_is_there(ranks, tmp_path):
    arguments = ("ny=3", "steps=4")
    results(CLAMPED, *arguments, output=tmp_path / "whole")
    half(tmp_path / "part", *arguments)
    results(CLAMPED, *arguments, "--restart", tmp_path / "part/checkpoint.h5", output=tmp_path / "part", ranks=ranks)
    one, other = ((tmp_path / name / "history.csv").read_text().split() for name in ("whole", "part"))
    assert len(one) == len(other) == 6
    assert np.allclose(
        *(np.array([row.split(",") for row in rows[1:]], dtype=float) for rows in (one, other)), rtol=1e-9
    )
    with h5py.File(tmp_path / "part" / "fields.h5") as file:
        assert sorted(file) == ["cells", "particles", *(f"step_{i:05d}" for i in range(5))]
    for step in range(5):
        one, other = (field(tmp_path / name, "displacement", step) for name in ("whole", "part"))
        assert np.abs(one - other).max() <= 1e-10 * np.abs(field(tmp_path / "whole", "displacement")).max()
    assert (tmp_path / "part" / "fields.xdmf").read_text() == (tmp_path / "whole" / "fields.xdmf").read_text()


def test_a_checkpoint_of_another_body_is_refused(tmp_path):
    pd.run(strip(), output=tmp_path)
    other = strip(particles=pd.Lattice((0.0, 0.0), (11.0, 4.0), 1.0))
    with pytest.raises(pd.CaseError, match="another body"):
        pd.run(other, output=tmp_path / "new", restart=tmp_path / "checkpoint.h5")


def signalled(folder, number, ranks):
    """Start a long run, signal it after its third step, and return the finished process."""
    words = command(CLAMPED, "ny=5", "horizon=2.015", "G=0.5", "steps=5000", ranks=ranks, output=folder)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
    history = folder / "history.csv"
    wait_until(lambda: history.exists() and len(history.read_text().splitlines()) > 4, "The third step")
    process.send_signal(number)
    out, err = process.communicate(timeout=300)
    return process.returncode, out, err


@pytest.mark.parametrize(
    ("number", "ranks"),
    [
        (signal.SIGINT, 2),
        pytest.param(signal.SIGTERM, 1, marks=pytest.mark.long),
        pytest.param(signal.SIGINT, 1, marks=pytest.mark.long),
        pytest.param(signal.SIGTERM, 2, marks=pytest.mark.long),
    ],
)
def test_a_signal_ends_the_run_with_valid_files(number, ranks, tmp_path):
    status, _, err = signalled(tmp_path, number, ranks)
    assert status != 0
    if ranks == 1:
        assert status == 1
        assert "Stopped by a signal" in err
        assert summary(tmp_path)["status"].startswith("Stopped by a signal")
    rows = np.loadtxt(tmp_path / "history.csv", delimiter=",", skiprows=1)
    with h5py.File(tmp_path / "fields.h5") as file:
        steps = sorted(name for name in file if name.startswith("step_"))
        assert len(steps) >= len(rows) >= 4
        assert np.isfinite(file[steps[-1]]["displacement"]).all()
    with h5py.File(tmp_path / "checkpoint.h5") as file:
        assert json.loads(file.attrs["head"])["step"] >= len(rows) - 2
    ET.parse(tmp_path / "fields.xdmf")


@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=pytest.mark.long)])
def test_no_room_for_a_step_leaves_the_steps_before(ranks, tmp_path):
    """The file size limit stands for a full disk: both show as an error when a file grows."""

    case = tmp_path / "limited.py"
    case.write_text(
        f"import dataclasses, resource, sys\nsys.path.insert(0, {str(CLAMPED.parent)!r})\n"
        "import clamped\nimport pdpetsc as pd\n\n"
        "def limited(solution):\n    if solution.step == 5:\n"
        "        resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))\n    return solution.volume\n\n"
        "def case():\n    whole = clamped.case(ny=5, steps=20)\n"
        "    return dataclasses.replace(whole, picture=None, fields=[pd.displacement, limited])\n"
    )
    finished = run(case, "--quiet", ranks=ranks, output=tmp_path)
    assert finished.returncode == 1, finished.stderr
    assert "step_00005.h5 cannot grow" in finished.stderr
    rows = np.loadtxt(tmp_path / "history.csv", delimiter=",", skiprows=1)
    with h5py.File(tmp_path / "fields.h5") as file:
        steps = [name for name in file if name.startswith("step_")]
        assert len(steps) == len(rows) >= 2
        assert all(np.isfinite(file[name]["displacement"]).all() for name in steps)
    assert "cannot grow" in summary(tmp_path)["status"]


@pytest.mark.long
def test_an_unexpected_error_on_one_rank_ends_all(tmp_path):
    case = tmp_path / "case.py"
    case.write_text(
        "import pdpetsc as pd\nfrom mpi4py import MPI\n\n"
        "def field(solution):\n    if MPI.COMM_WORLD.rank == 1:\n        raise RuntimeError('broken field')\n"
        "    return solution.volume\n\n"
        "def case():\n    return pd.Case(particles=pd.Lattice((0.0, 0.0), (4.0, 4.0), 1.0), horizon=1.5,\n"
        "        material=pd.Hencky(E=1.0, nu=0.0), fields=[field],\n"
        "        conditions=[pd.Displacement(pd.region.All(), x=0.0, y=0.0)])\n"
    )
    finished = run(case, ranks=2, output=tmp_path / "out")
    assert finished.returncode != 0
    assert "broken field" in finished.stderr


@pytest.mark.long
def test_predicted_matrix_memory_is_what_is_measured(tmp_path):
    """The prediction against the growth of the process when the matrix is made, for a matrix of some 140 MiB."""
    script = """
import petsc4py, numpy as np, resource, sys
petsc4py.init()
import pdpetsc as pd
from pdpetsc.running.build import make_cloud, make_problem
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.families import find_families
from pdpetsc.problem.assembly import Assembler
from pdpetsc.petsc.matrix import TangentMatrix, predicted_bytes

def resident():
    return int(open("/proc/self/statm").read().split()[1]) * resource.getpagesize()

lattice = pd.Lattice((0.0, 0.0), (161.0, 161.0), 1.0)
case = pd.Case(particles=lattice, horizon=3.015, material=pd.Hencky(1, 0), scheme=pd.Correspondence(), conditions=[])
cloud = make_cloud(world(), case)
assembler = Assembler(make_problem(case, cloud, find_families(cloud)))
before = resident()
matrix = TangentMatrix(assembler, np.zeros((cloud.n_owned, 2), bool), 1.0)
print(predicted_bytes(assembler.pattern, 2), resident() - before)
matrix.destroy()
"""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    words = [command("x")[0], "-c", script]
    out = subprocess.run(words, capture_output=True, text=True, env=environment, check=True, timeout=300).stdout
    predicted, measured = map(int, out.split())
    assert predicted > 100 * 2**20
    assert measured == pytest.approx(predicted, rel=0.2)
