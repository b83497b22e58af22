# make run: the clamped beam on 2 ranks. make test: the test suite. Both set up what is missing first.
PYTHON := .venv/bin/python

.PHONY: run test long lint types clean

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

clean:
	rm -rf .venv out .pytest_cache .mypy_cache .ruff_cache
