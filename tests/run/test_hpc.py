"""Batch scripts with stand-ins for srun and sbatch, stages of PETSc's log, and what each rank holds."""

import contextlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from numba.core.caching import _CacheLocator

from tests.commands import ROOT, run, script_on, summary

SCRIPTS = sorted((ROOT / "runs" / "hpc").glob("*.s*"))
ON_TWO_RANKS = f'exec "{ROOT / ".ci" / "mpirun"}" 2 "$@"'
# Its first run gets a signal after three steps, as from a batch system that runs out of time.
OUT_OF_TIME = """
import dataclasses, os, signal, sys
from pathlib import Path
sys.path.insert(0, {folder!r})
import clamped
import pdpetsc as pd

class Energy(pd.Quantity):
    def evaluate(self, solution):
        stopped = Path(__file__).with_name("stopped")
        if solution.step == 3 and not stopped.exists():
            stopped.touch()
            os.kill(os.getpid(), signal.SIGTERM)
        return 0.0

def case():
    whole = clamped.case(ny=3, steps=10)
    return dataclasses.replace(whole, history={{**whole.history, "none": Energy()}})
"""


@pytest.fixture(scope="module")
def kernels(tmp_path_factory):
    """Return a folder of kernels as the scripts keep it, with those that this checkout has compiled already."""
    folder = tmp_path_factory.mktemp("kernels")
    for room in ("kernels", "material"):
        place = ROOT / "pdpetsc" / room
        name = _CacheLocator.get_suitable_cache_subpath(str(place / "__init__.py"))
        with contextlib.suppress(OSError):  # none yet, or one that another process writes now
            shutil.copytree(
                place / "__pycache__", folder / name, ignore=shutil.ignore_patterns("pdpetsc_made", "*.py?")
            )
    return folder


@pytest.fixture(autouse=True)
def kept(kernels, monkeypatch):
    if "NUMBA_CACHE_DIR" not in os.environ:
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(kernels))


def submit(folder, script, *words, srun=ON_TWO_RANKS, **variables):
    """Run a batch script as a batch system does; return the finished process."""
    stand_ins = folder / "bin"
    stand_ins.mkdir(exist_ok=True)
    for name, text in {"srun": srun, "sbatch": 'exec bash "$@"'}.items():
        (stand_ins / name).write_text(f"#!/bin/bash\n{text}\n")
        (stand_ins / name).chmod(0o755)
    path = f"{stand_ins}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT), "HOME": str(folder), **variables}
    return subprocess.run(
        ["bash", f"runs/hpc/{script}", *map(str, words)],
        cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_scripts_have_no_syntax_error_and_ask_for_a_warning_before_the_end(script):
    subprocess.run(["bash", "-n", str(script)], check=True)
    if script.suffix == ".slurm":
        assert "#SBATCH --signal=TERM@" in script.read_text()


@pytest.mark.long
def test_a_job_runs_the_case_on_all_ranks(tmp_path):
    finished = submit(tmp_path, "job.slurm", "runs/beams/clamped.py", "ny=3", "steps=1", "-o", tmp_path / "out")
    assert finished.returncode == 0, finished.stderr
    found = summary(tmp_path / "out")
    assert found["ranks"] == 2
    assert 0.0 < found["results"]["error"] < 0.1


@pytest.mark.long
def test_a_job_on_several_nodes_takes_kernels_from_their_disks(tmp_path):
    variables = {"SLURM_JOB_NUM_NODES": "2", "SLURM_JOB_ID": "7", "TMPDIR": str(tmp_path / "local")}
    srun = 'while [[ "$1" == --ntasks* ]]; do shift; done; exec "$@"'
    words = "runs/beams/clamped.py", "ny=3", "steps=1", "-o", tmp_path / "out"
    finished = submit(tmp_path, "job.slurm", *words, srun=srun, **variables)
    assert finished.returncode == 0, finished.stderr
    assert list((tmp_path / "local" / "pdpetsc-7" / "kernels").rglob("*.nbi"))


@pytest.mark.long
def test_an_array_runs_a_line_of_parameters_in_each_task(tmp_path):
    lines = tmp_path / "lines.txt"
    lines.write_text("ny=3 steps=1\nny=5 steps=2\n")
    words = lines, "runs/beams/clamped.py", "-o", tmp_path / "study", "-snes_rtol", "1e-8"
    finished = submit(tmp_path, "array.slurm", *words, srun='exec "$@"', SLURM_ARRAY_TASK_ID="2")
    assert finished.returncode == 0, finished.stderr
    assert len(summary(tmp_path / "study" / "2")["steps"]) == 2
    finished = submit(tmp_path, "array.slurm", *words, SLURM_ARRAY_TASK_ID="3")
    assert finished.returncode == 2
    assert "has no line 3" in finished.stderr


@pytest.mark.long
def test_a_chain_goes_on_where_time_ran_out(tmp_path):
    case = tmp_path / "chained.py"
    case.write_text(OUT_OF_TIME.format(folder=str(ROOT / "runs" / "beams")))
    finished = submit(tmp_path, "chain.slurm", tmp_path / "out", case, srun='exec "$@"')
    assert finished.returncode == 0, finished.stderr
    assert "Stopped by a signal" in finished.stderr
    found = summary(tmp_path / "out")
    assert found["status"] == "converged"
    assert 1 <= found["restart"]["step"] < 10
    assert [step["step"] for step in found["steps"]] == list(range(1, 11))
    history = (tmp_path / "out" / "history.csv").read_text().splitlines()
    assert len(history) == 12


def test_the_log_has_a_stage_for_everything_that_takes_time(tmp_path):
    words = "dim=2", "n=12", "-pd_jacobian", "matfree", "-log_view"
    found = run("runs/bench/box.py", *words, output=tmp_path / "out")
    assert found.returncode == 0, found.stderr
    for name in ("search", "set-up", "residual", "tangent", "preconditioner", "output"):
        assert f":{name}:" in found.stdout.replace(" ", ""), name


SIZES = """
import sys, tracemalloc
import petsc4py
petsc4py.init(["sizes", "-pd_jacobian", "matfree"])
import numpy as np
import pdpetsc as pd
from pdpetsc.running.build import make_cloud, make_problem, rehearse
from pdpetsc.discrete.communicator import world
from pdpetsc.discrete.families import find_families
from pdpetsc.discrete.components import refuse_rigid_motion
from pdpetsc.declare.solvers import Newton
from pdpetsc.petsc.defaults import default_options
from pdpetsc.petsc.jacobian import assembler, choose
from pdpetsc.petsc.options import Options
from pdpetsc.problem.background_elements import BackgroundElements
from pdpetsc.solvers.newton import StaticSolver
comm = world()
sys.path.insert(0, "runs/bench")
from box import case
scene = case(dim=2, n=20)
import dataclasses
strip = pd.Lattice([0.0, 0.0], [60.0 * comm.size, 8.0], 1.0)
held = pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0, y=0.0)
pulled = pd.Displacement(pd.region.Slab("x", low=60.0 * comm.size - 1.0), x=0.1)
scene = dataclasses.replace(scene, particles=strip, conditions=[held, pulled])
rehearse(comm, scene, 2)
rehearse(comm, scene, 2, BackgroundElements)
sites = {}
# What the compiler of kernels keeps does not depend on the particles.
compiler = [tracemalloc.Filter(False, f"*/{package}/*") for package in ("numba", "llvmlite")]
def look():
    for found in tracemalloc.take_snapshot().filter_traces(compiler).statistics("lineno"):
        site = f"{found.traceback[0].filename.split('pdpetsc/')[-1]}:{found.traceback[0].lineno}"
        sites[site] = max(sites.get(site, 0), found.size)
tracemalloc.start()
cloud = make_cloud(comm, scene); look()
families = find_families(cloud); look()
problem = make_problem(scene, cloud, families); look()
refuse_rigid_motion(cloud, families, problem.resisted); look()
choice = choose(problem, {}, Newton())
with Options({}).suggest(default_options(problem, Newton(), choice)).active():
    solver = StaticSolver(problem, assembler(problem, choice), lambda: False); look()
    u, result = solver.solve(np.zeros((cloud.n_owned, 2)), 1.0); look()
    assert result.converged
    solver.destroy()
if comm.rank == 1:
    import json
    print(json.dumps({"particles": cloud.n_global, "owned": cloud.n_owned, "sites": sites}))
"""


@pytest.mark.long
def test_no_array_of_a_rank_grows_with_the_whole(tmp_path):
    """A strip twice as long on twice as many ranks: what a rank in its middle holds, by the line that allocated it."""
    script = tmp_path / "sizes.py"
    script.write_text(SIZES)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    found = []
    for ranks in (3, 6):
        words = [str(ROOT / ".ci" / "mpirun"), str(ranks), sys.executable, str(script)]
        finished = subprocess.run(
            words, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300, check=True
        )
        found.append(json.loads(finished.stdout.splitlines()[-1]))
    small, large = found
    assert large["particles"] == 2 * small["particles"]
    assert large["owned"] == small["owned"]
    # Three bytes for each particle more: below an index. What Python itself keeps differs by less from run to run.
    index = 3 * (large["particles"] - small["particles"])
    grown = {
        site: (small["sites"].get(site, 0), size)
        for site, size in large["sites"].items()
        if size > max(small["sites"].get(site, 0) + index, 1.3 * small["sites"].get(site, 0))
    }
    assert not grown
    assert max(small["sites"].values()) > 8 * small["particles"]


TOGETHER = """
import sys
from pathlib import Path
import h5py
import numpy as np
import pdpetsc as pd
from pdpetsc.discrete.cloud import distribute
from pdpetsc.discrete.communicator import world
from pdpetsc.output.fields import FieldWriter
from pdpetsc.output.files import InCreationOrder
comm = world()
chunk = pd.Lattice([0.0, 0.0], [9.0, 7.0], 1.0).chunk(comm.rank, comm.size)
cloud = distribute(comm, chunk.x, chunk.volume, chunk.sets, 1.1)
order = InCreationOrder(cloud)
folder = Path(sys.argv[1])
for name in ("turn", "together"):
    if comm.rank == 0:
        (folder / name).mkdir()
    comm.Barrier()
    writer = FieldWriter(cloud, order, folder / name, [])
    if name == "together":
        print("parallel", h5py.get_config().mpi, flush=True)
    writer.parallel = name == "together" and h5py.get_config().mpi
    for step in range(2):
        x = cloud.x[: cloud.n_owned] + step
        writer.put(step, 0.5, {"y": x, "n": cloud.gid[: cloud.n_owned], "T": x[:, :, None] * x[:, None]})
"""


def test_fields_are_the_same_written_together_or_in_turn(tmp_path):
    if "parallel True" not in script_on(2, TOGETHER, tmp_path):
        pytest.skip("h5py has no parallel HDF5: serial would be compared with serial")
    with h5py.File(tmp_path / "turn/fields.h5", "r") as one, h5py.File(tmp_path / "together/fields.h5", "r") as two:
        for step in ("step_00000", "step_00001"):
            assert one[step].attrs["t"] == two[step].attrs["t"] == 0.5
            for name in ("y", "n", "T", "T_xy"):
                assert np.array_equal(one[f"{step}/{name}"], two[f"{step}/{name}"])
        assert np.array_equal(two["step_00001/n"], np.arange(63))
