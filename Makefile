# Two commands on a fresh machine with Python 3.11 or later:  make demo   and   make test
#
#   make demo         track a rendered scene with the filter and without; says where to look
#   make lint         style, types, imports, generated pages
#   make test         lint and the fast tests: five minutes on two cores, seven the first time
#   make test-slow    browsers, processes, real time, many seeds, experiments in their short form
#   make experiments  the tables under docs/results/ (hours); ARGS="m07 --quick" for a short one
#   make docs-check   lists the tables that are older than their code, and the command for each
#   make bench        ratios to other libraries and programs, about five minutes
#   make bench-full   all of speed and memory, with all sizes, more frames and seeds
#   make format       reformat the sources
#   make docs         write the generated pages and types, and the outputs of notebooks, again
#   make site         the documentation as a website that works offline, in build/site
#
# PYTHON=... chooses the interpreter for the environment, VENV=... its folder. PYTEST_ARGS=... is
# passed to pytest.

PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3 python; do \
	"$$p" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && \
	{ command -v "$$p"; break; }; done)
VENV ?= .venv
PY := $(VENV)/bin/python
BIN := $(VENV)/bin
READY := $(VENV)/.ready
STAMP := $(VENV)/.installed
PEERS := .venv-peers
SITE_ENV := .venv-site
CLUSTER := $(VENV)/.cluster
SITE := build/site
CODE := src tests experiments scripts benchmarks

export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Modules are installed without bytecode, and tests start hundreds of processes: each would compile
# all that it imports.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.NOTPARALLEL:
.PHONY: help env test test-slow lint warm pytest pytest-plain demo docs-check experiments \
	bench bench-full peers format docs site clean

help:
	@sed -n 's/^#   //p' Makefile

env: $(STAMP)

# A stamp is newer than its sources, so an up-to-date environment costs nothing.
# Everything is installed as the constraints pin it, the build backend too, and pip checks each file
# by its hash; the project itself has none, so it comes last. Dependencies are not followed: those
# of TrackEval would replace OpenCV 4 by OpenCV 5, which has no cascades. A test checks that nothing
# is missing. Modules are compiled when they are first imported: most of them never are.
PIP_INSTALL := -m pip install --quiet --no-compile --no-deps

# What tracking, the report and the pages need: all that the demo waits for.
$(READY): pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { \
		echo "phdtrack needs Python 3.11 or later: install it," \
			"or use make PYTHON=/path/to/python3" >&2; exit 1; }
	@$(PY) -m pip --version >/dev/null 2>&1 || "$(PYTHON)" -m venv --clear $(VENV) || { \
		echo "$(PYTHON) cannot create an environment:" \
			"on Debian and Ubuntu, apt-get install python3-venv" >&2; exit 1; }
	$(PY) $(PIP_INSTALL) --require-hashes -r constraints.txt
	$(PY) $(PIP_INSTALL) --no-build-isolation -e .
	@touch $@

# What the checks and the other formats need besides.
$(STAMP): $(READY) tests/dev-constraints.txt
	$(PY) $(PIP_INSTALL) --require-hashes -r tests/dev-constraints.txt
	@touch $@

test: lint pytest-plain warm pytest

lint: env
	$(BIN)/ruff check $(CODE)
	$(BIN)/ruff format --check $(CODE)
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo
	$(PY) scripts/equations.py --check
	$(PY) scripts/section_types.py --check

# The kernels as plain Python: this finds what compiled code hides, as an index past the end.
pytest-plain: env
	NUMBA_DISABLE_JIT=1 $(PY) -m pytest -q -n auto --maxprocesses 4 --dist loadfile tests/kernels

# Compile the kernels before the test processes start, which would all compile the same ones.
warm: env
	$(PY) tests/warm.py

# One process per core; a module's tests share fixtures and stay in one process.
pytest: env
	$(PY) -m pytest -q -n auto --maxprocesses 4 --dist loadfile $(PYTEST_ARGS)

test-slow: env $(CLUSTER) warm
	$(PY) -m pytest -q -n auto --maxprocesses 4 --dist loadfile -m slow $(PYTEST_ARGS)

# Ray is large, and has no wheels for some machines: without it its tests skip.
$(CLUSTER): tests/cluster-constraints.txt $(STAMP)
	@$(PY) $(PIP_INSTALL) --require-hashes -r $< && touch $@ \
		|| echo "Ray cannot be installed: its tests are skipped" >&2

demo: $(READY)
	$(BIN)/phdtrack demo --out demo-run --overwrite

docs-check: env
	$(PY) -m experiments --check

experiments: env
	$(PY) -m experiments $(or $(ARGS),all)

bench: env peers
	$(PY) -m benchmarks

bench-full: env peers
	$(PY) -m benchmarks --full

# The peer trackers have an environment of their own, because they need another OpenCV. If it
# cannot be created, the benchmark reports this and measures the rest.
peers: $(PEERS)/.installed

$(PEERS)/.installed: benchmarks/peers-constraints.txt | env
	@{ test -x $(PEERS)/bin/python || $(PY) -m venv $(PEERS); } \
		&& $(PEERS)/bin/python -m pip install --quiet --require-hashes --no-deps -r $< && touch $@ \
		|| echo "no environment for the peer trackers: the benchmark continues without them" >&2

format: env
	$(BIN)/ruff check --fix $(CODE)
	$(BIN)/ruff format $(CODE)

docs: env
	$(PY) scripts/equations.py
	$(PY) scripts/section_types.py
	$(PY) scripts/notebooks.py

# The site's tools have an environment of their own. A broken link is an error.
site: $(SITE_ENV)/.installed
	NO_MKDOCS_2_WARNING=1 $(SITE_ENV)/bin/mkdocs build --quiet --strict --site-dir "$(abspath $(SITE))"
	@echo "the site: $(SITE)/index.html"

$(SITE_ENV)/.installed: scripts/site-constraints.txt | env
	test -x $(SITE_ENV)/bin/python || $(PY) -m venv $(SITE_ENV)
	$(SITE_ENV)/bin/python $(PIP_INSTALL) --require-hashes -r $<
	@touch $@

clean:
	rm -rf $(VENV) $(PEERS) $(SITE_ENV)
	rm -rf .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
