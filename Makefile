# make run: the clamped beam on 2 ranks. make test: the test suite. make docs: the site, site/index.html.
# All set up what is missing first.
PYTHON := .venv/bin/python

.PHONY: run test long lint types docs clean

.venv/ready: pyproject.toml .ci/setup packaging/debian
	.ci/setup

run: .venv/ready
	.ci/mpirun 2 $(PYTHON) -m pdpetsc runs/beams/clamped.py ny=5 -o out/clamped

test: .venv/ready
	$(PYTHON) -m pytest -n 3

long: .venv/ready
	$(PYTHON) -m pytest -n 2 -m long

lint: .venv/ready
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .

types: .venv/ready
	.venv/bin/mypy

# What the site is built with goes into .venv at the first make docs only.
.venv/docs: .venv/ready
	$(PYTHON) -c "import tomllib; print(*tomllib.load(open('pyproject.toml', 'rb'))['project']['optional-dependencies']['docs'], 'numpy<2', sep='\n')" > .venv/docs.txt
	$(PYTHON) -m pip install -q --disable-pip-version-check -r .venv/docs.txt
	touch .venv/docs

docs: .venv/docs
	rm -rf site docs/api/generated docs/examples
	[ ! -e docs/gallery.py ] || PYTHONPATH=. $(PYTHON) docs/gallery.py docs/examples
	PYTHONPATH=. $(PYTHON) -m sphinx -E -W --keep-going -q -j 2 -d out/doctrees docs site

clean:
	rm -rf .venv site docs/api/generated docs/examples out .pytest_cache .mypy_cache .ruff_cache
