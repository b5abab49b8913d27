# Two commands on a fresh machine with Python 3.11 or later:  make demo   and   make test
#
#   make demo         a rendered scene, tracked with the filter and without; says where to look
#   make test         style, types, imports, generated pages and the fast tests: some minutes on two cores
#   make test-slow    the tests that take long: statistics over many seeds, and every experiment in its short form
#   make experiments  the measured tables under docs/results/ (hours); ARGS="m07 --quick" for one of them, shortened
#   make docs-check   which of these tables are older than the code and settings that they show, and the command for each
#   make bench        speed and memory beside other libraries, below five minutes
#   make bench-full   the same with all sizes, more frames and seeds
#   make format       put the sources into the one style
#   make docs         write the generated pages anew
#   make site         the documentation as a site that needs no network, in build/site
#
# PYTHON=... chooses the interpreter that makes the environment, VENV=... where it lies, PYTEST_ARGS=... is passed on.

PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3 python; do \
	"$$p" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { command -v "$$p"; break; }; done)
VENV ?= .venv
PY := $(VENV)/bin/python
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
PEERS := .venv-peers
SITE_ENV := .venv-site
CLUSTER := $(VENV)/.cluster
SITE := build/site
CODE := src tests experiments scripts benchmarks

export PIP_DISABLE_PIP_VERSION_CHECK := 1

.DEFAULT_GOAL := help
.NOTPARALLEL:
.PHONY: help env test test-slow lint pytest pytest-plain demo docs-check experiments bench bench-full peers format docs site clean

help:
	@sed -n 's/^#   //p' Makefile

env: $(STAMP)

# The stamp is newer than what it was made from, so an environment that is up to date costs nothing.
# Everything is installed as constraints.txt pins it, the build backend too, and pip checks each file by its hash; the project
# itself has none, so it comes after. Nothing follows dependencies: those of TrackEval would put OpenCV 5, which has no
# cascades, over OpenCV 4. That nothing is missing is checked by the tests.
$(STAMP): pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "phdtrack needs Python 3.11 or later, and none was found: install it, or say make PYTHON=/path/to/python3" >&2; exit 1; }
	@$(PY) -m pip --version >/dev/null 2>&1 || "$(PYTHON)" -m venv --clear $(VENV) || { echo "$(PYTHON) cannot make an environment: on Debian and Ubuntu, apt-get install python3-venv" >&2; exit 1; }
	$(PY) -m pip install --quiet --require-hashes --no-deps -r constraints.txt
	$(PY) -m pip install --quiet --no-deps --no-build-isolation -e .
	@touch $@

test: lint pytest-plain pytest

lint: env
	$(BIN)/ruff check $(CODE)
	$(BIN)/ruff format --check $(CODE)
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo
	$(PY) scripts/equations.py --check

# The kernels once more as plain Python: what the JIT hides (an index past the end, an overflow) shows here.
pytest-plain: env
	NUMBA_DISABLE_JIT=1 $(PY) -m pytest -q -n auto --maxprocesses 4 --dist loadfile tests/kernels

# A process for each core; a module's tests stay in one, for they share what they have made.
pytest: env
	$(PY) -m pytest -q -n auto --maxprocesses 4 --dist loadfile $(PYTEST_ARGS)

test-slow: env $(CLUSTER)
	$(PY) -m pytest -q -n auto --maxprocesses 4 --dist loadfile -m slow $(PYTEST_ARGS)

# Ray and Rerun are large, and have no wheels for some machines: where they cannot be installed their tests say so and are skipped.
$(CLUSTER): tests/cluster-constraints.txt $(STAMP)
	@$(PY) -m pip install --quiet --require-hashes --no-deps -r $< && touch $@ \
		|| echo "Ray and Rerun could not be installed: the tests of the cluster and of recordings are skipped" >&2

demo: env
	$(BIN)/phdtrack demo --out demo-run --overwrite

docs-check: env
	$(PY) -m experiments --check

experiments: env
	$(PY) -m experiments $(or $(ARGS),all)

bench: env peers
	$(PY) -m benchmarks

bench-full: env peers
	$(PY) -m benchmarks --full

# The trackers to compare with live in an environment of their own: they bring another OpenCV. Where it cannot be made, the
# benchmark says so in their place and measures the rest.
peers: $(PEERS)/.installed

$(PEERS)/.installed: benchmarks/peers-constraints.txt | env
	@{ test -x $(PEERS)/bin/python || $(PY) -m venv $(PEERS); } \
		&& $(PEERS)/bin/python -m pip install --quiet --require-hashes --no-deps -r $< && touch $@ \
		|| echo "the environment of the other trackers could not be made; the benchmark goes on without them" >&2

format: env
	$(BIN)/ruff check --fix $(CODE)
	$(BIN)/ruff format $(CODE)

docs: env
	$(PY) scripts/equations.py

# What builds the site lives in an environment of its own, as nothing else needs it. A link that leads nowhere is an error.
site: $(SITE_ENV)/.installed
	NO_MKDOCS_2_WARNING=1 $(SITE_ENV)/bin/mkdocs build --quiet --strict --site-dir "$(abspath $(SITE))"
	@echo "the site: $(SITE)/index.html"

$(SITE_ENV)/.installed: scripts/site-constraints.txt | env
	test -x $(SITE_ENV)/bin/python || $(PY) -m venv $(SITE_ENV)
	$(SITE_ENV)/bin/python -m pip install --quiet --require-hashes --no-deps -r $<
	@touch $@

clean:
	rm -rf $(VENV) $(PEERS) $(SITE_ENV) .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
