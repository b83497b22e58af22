"""The wheel in an environment of its own, the doctor where something is broken, and the files that make images."""

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import pdpetsc as pd
from pdpetsc.command_line import doctor
from pdpetsc.discrete.communicator import world
from pdpetsc.loading import cannot_load
from tests.commands import ROOT
from tests.project.test_site import write_files

ALONE = {**os.environ, "OMP_NUM_THREADS": "1"}


def words_of(findings):
    return " ".join(f"{one.verdict} {one.what} {one.found} {one.advice}" for one in findings)


def without(folder, name, text):
    """Return the environment in which a package is found that cannot be loaded."""
    (folder / name).mkdir()
    (folder / name / "__init__.py").write_text(text)
    return {**ALONE, "PYTHONPATH": f"{folder}{os.pathsep}{ROOT}"}


def command(environment, *words):
    words = [sys.executable, "-m", "pdpetsc", *map(str, words)]
    return subprocess.run(words, env=environment, capture_output=True, text=True, timeout=300, check=False)


@pytest.mark.long
def test_the_doctor_says_that_petsc_was_built_for_another_numpy(tmp_path):
    """That is what pip leaves beside Debian's petsc4py, which is built for numpy 1: no traceback, and what to do."""
    said = "raise ValueError('numpy.dtype size changed, may indicate binary incompatibility')"
    environment = without(tmp_path, "petsc4py", f"def init(words): {said}\n")
    found = command(environment, "doctor")
    assert found.returncode == 1 and found.stderr == ""
    assert re.search(r"broken +petsc4py +petsc4py cannot be loaded with numpy", found.stdout)
    assert re.search(r'-> pip install "numpy[<>]=?2"', found.stdout)
    found = command(environment, "bar.py")
    assert found.returncode == 1 and len(found.stderr.splitlines()) == 1
    assert "petsc4py cannot be loaded with numpy" in found.stderr


def test_what_cannot_be_loaded_is_said_in_one_sentence(tmp_path):
    environment = without(tmp_path, "h5py", "raise ImportError('libhdf5.so.103: cannot open shared object file')\n")
    found = command(environment, "doctor")
    last = found.stderr.splitlines()[-1]
    assert found.returncode == 1
    assert last.startswith("ImportError: h5py cannot be loaded") and "libhdf5.so.103" in last and "anew" in last
    missing = ModuleNotFoundError("No module named 'petsc4py'", name="petsc4py")
    assert cannot_load("petsc4py", missing).startswith("petsc4py is not installed; take python3-petsc4py of Debian")
    assert cannot_load("rich", ModuleNotFoundError("no", name="rich")) == "rich is not installed; pip install rich"


def test_the_doctor_without_a_direct_solver(monkeypatch):
    monkeypatch.setattr(doctor, "DIRECT", "absent")
    found = list(doctor.petsc(world()))
    assert [one.verdict for one in found] == ["ok", "look"]
    assert "-pc_type gamg" in found[1].advice and "--download-mumps" in found[1].advice


def test_the_doctor_with_an_old_petsc_or_one_of_complex_numbers(monkeypatch):
    from petsc4py import PETSc

    monkeypatch.setattr(doctor, "OLDEST_PETSC", (99, 0))
    assert [one.verdict for one in doctor.petsc(world())] == ["broken"]
    monkeypatch.setattr(doctor, "OLDEST_PETSC", (3, 18))
    monkeypatch.setattr(PETSc, "ScalarType", complex)
    assert "complex" in words_of(doctor.petsc(world())) and "broken" in words_of(doctor.petsc(world()))


def test_the_doctor_with_the_reference_blas_too_many_ranks_and_no_room(monkeypatch):
    assert "ok" in words_of(doctor.blas(world())) or "look" in words_of(doctor.blas(world()))
    monkeypatch.setattr(doctor, "SLOW_BLAS", 1e18)
    assert "apt-get install libopenblas0-serial" in words_of(doctor.blas(world()))
    monkeypatch.setenv("OMP_NUM_THREADS", "100000")
    assert "look cores" in words_of(doctor.core_counts(world()))
    monkeypatch.setattr(doctor, "LITTLE", 2**80)
    assert "look disk" in words_of(doctor.disk(world()))


def test_the_doctor_where_no_kernel_can_be_kept(monkeypatch):
    monkeypatch.setattr("pdpetsc.kernels.compile._trouble", ["OSError: read-only file system"])
    (found,) = doctor.kernels(world())
    assert found.verdict == "look" and "read-only" in found.found and "NUMBA_CACHE_DIR" in found.advice


def test_the_doctor_where_ranks_do_not_hear_each_other(monkeypatch):
    class Deaf:
        """Two ranks, of which the other one never sends."""

        rank, size = 0, 2

        def Irecv(self, *_, **__):
            return self

        Isend = Irecv

        def Test(self):
            return False

    monkeypatch.setattr(doctor, "PATIENCE", 0.05)
    assert doctor._around(Deaf()) is None


ON_TWO = """
import os, sys
from pdpetsc.command_line import doctor
from pdpetsc.command_line.start import start_petsc
start_petsc()
from pdpetsc.discrete.communicator import world
found = [*doctor.ranks(world()), *doctor.hdf5(world())]
os.chdir("/proc")
found += doctor.hdf5(world())
if world().rank == 0:
    doctor.tell(found)
"""


def test_the_doctor_on_two_ranks_sends_messages_and_writes_a_file(tmp_path):
    words = [str(ROOT / ".ci" / "mpirun"), "2", sys.executable, "-c", ON_TWO]
    environment = {**ALONE, "PYTHONPATH": str(ROOT)}
    found = subprocess.run(
        words, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
    )
    assert "2 ranks that hear each other at" in found.stdout, found.stderr
    if "parallel" in found.stdout:
        assert "2 ranks wrote one file" in found.stdout
        assert "parallel, but not in /proc" in found.stdout
    assert list(tmp_path.iterdir()) == []


# What images and recipes say.


def test_images_and_recipe_need_what_the_package_needs():
    """The same names and lower bounds everywhere; images and what runs the tests take one script."""
    project = (ROOT / "pyproject.toml").read_text()
    block = project.split("\ndependencies = ")[1].split("\n]")[0] + "\n]"
    needed = dict(re.fullmatch(r"(\w+)>=([\d.]+)", one).groups() for one in ast.literal_eval(block))
    recipe = (ROOT / "packaging/conda/recipe.yaml").read_text()
    run = recipe.split("  run:\n")[1].split("\ntests:")[0]
    of_recipe = dict(re.findall(r"- ([\w-]+) >=([\d.]+)", run))
    assert {name.removesuffix("-base"): bound for name, bound in of_recipe.items()} == needed
    assert f'version: "{pd.__version__}"' in recipe
    assert re.search(r'requires-python = ">=([\d.]+)"', project)[1] == re.search(r'python_min: "([\d.]+)"', recipe)[1]
    for name in ("packaging/Dockerfile", "packaging/pdpetsc.def", ".ci/setup"):
        assert "packaging/debian" in (ROOT / name).read_text()
    debian = (ROOT / "packaging/debian").read_text()
    for name in needed.keys() - {"mpi4py", "petsc4py", "h5py"}:
        assert re.search(rf'"{name}[<>]', debian), name


def built(folder):
    """Return the wheel of the files that belong to the checkout, built in a copy of them."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    names = (
        listed.stdout.split("\0") if listed.returncode == 0 else [p.name for p in ROOT.iterdir() if p.name != ".venv"]
    )
    for name in filter(None, names):
        if (ROOT / name).is_file():
            (folder / "copy" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / "copy" / name)
    words = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(folder), str(folder / "copy")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return next(folder.glob("pdpetsc-*.whl"))


@pytest.mark.long
def test_the_wheel_in_an_environment_of_its_own_runs_the_case_of_the_readme_on_two_ranks(tmp_path):
    """As a user has it: a virtual environment that sees the system's petsc4py, and pip."""
    wheel, inside = built(tmp_path), tmp_path / "env"
    base = getattr(sys, "_base_executable", sys.executable)
    subprocess.run([base, "-m", "venv", "--system-site-packages", str(inside)], check=True, timeout=300)
    clean = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")}
    clean |= {
        "OMP_NUM_THREADS": "1", "OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "OMPI_MCA_rmaps_base_oversubscribe": "1", "OMPI_MCA_btl_vader_single_copy_mechanism": "none",
        "PATH": f"{inside / 'bin'}{os.pathsep}{os.environ['PATH']}",
    }  # fmt: skip
    work = tmp_path / "work"
    work.mkdir()

    def call(*words, timeout=300):
        done = subprocess.run(
            list(map(str, words)), cwd=work, env=clean, capture_output=True, text=True, timeout=timeout, check=False
        )
        assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
        return done.stdout

    call(inside / "bin/python", "-m", "pip", "install", "-q", f"{wheel}[numpy1]")
    # The one that is imported is the wheel's, and nothing of the checkout is on the path.
    where, *path = call(
        inside / "bin/python", "-c", "import pdpetsc, sys; print(pdpetsc.__file__, *filter(None, sys.path), sep='\\n')"
    ).splitlines()
    assert Path(where).is_relative_to(inside)
    assert not any(Path(one) == ROOT or Path(one).is_relative_to(ROOT / "pdpetsc") for one in path)
    said = call("mpirun", "-n", "2", "pdpetsc", "doctor")
    assert "2 ranks that hear each other" in said and "broken" not in said
    write_files(ROOT / "README.md", work)
    said = call("mpirun", "-n", "2", "pdpetsc", "bar.py", "-o", "out/bar")
    # Hooke's law, with the held end a little stiffer: 20 N/mm^2 over 1000 N/mm^2 along 20 mm.
    assert float(re.search(r"u_end = ([\d.]+)", said)[1]) == pytest.approx(20.0 / 1000.0 * 20.0, rel=0.03)
    assert (work / "out/bar/picture.png").exists() and (work / "out/bar/fields.h5").exists()
