# make run: the clamped beam on 2 ranks. make test: the test suite. make docs: the site, site/index.html.
# All set up what is missing first.
PYTHON := .venv/bin/python

.PHONY: run test long processors lint types docs clean

.venv/ready: pyproject.toml .ci/setup packaging/debian
	.ci/setup

run: .venv/ready
	.ci/mpirun 2 $(PYTHON) -m pdpetsc runs/beams/clamped.py ny=5 -o out/clamped

test: .venv/ready
	@echo "The default tests take 6 to 12 minutes on two cores, and 4 more at first, when kernels are compiled."
	$(PYTHON) -m pytest -n auto --maxprocesses 4

long: .venv/ready
	$(PYTHON) -m pytest -n 2 -m long

# Where rounding decides, as an x86 without AVX and one without AVX-512 round: other sums in BLAS, numpy and kernels.
NO_AVX512 := AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX512_SPR
processors: .venv/ready
	OPENBLAS_CORETYPE=Nehalem NUMBA_CPU_NAME=generic NPY_DISABLE_CPU_FEATURES="AVX AVX2 FMA3 F16C $(NO_AVX512)" $(PYTHON) -m pytest -n 2 -m "processors and not long"
	OPENBLAS_CORETYPE=Haswell NPY_DISABLE_CPU_FEATURES="$(NO_AVX512)" $(PYTHON) -m pytest -n 2 -m "processors and not long"

lint: .venv/ready
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .

types: .venv/ready
	.venv/bin/mypy

# What the site is built with goes into .venv at the first make docs only.
.venv/docs: .venv/ready
	$(PYTHON) -c "import tomllib; print(*tomllib.load(open('pyproject.toml', 'rb'))['project']['optional-dependencies']['docs'], 'numpy<2', sep='\n')" > .venv/docs.txt
	$(PYTHON) -m pip install -qq --disable-pip-version-check -r .venv/docs.txt
	touch .venv/docs

docs: .venv/docs
	rm -rf site docs/api/generated docs/examples
	[ ! -e docs/gallery.py ] || PYTHONPATH=. $(PYTHON) docs/gallery.py docs/examples
	PYTHONPATH=. $(PYTHON) -m sphinx -E -W --keep-going -q -j 2 -d out/doctrees docs site

clean:
	rm -rf .venv site docs/api/generated docs/examples out .pytest_cache .mypy_cache .ruff_cache
