# make demo   calibrate MedRUE from the measurement file that ships with the project, into out/demo/
# make test   the tests
# make lint   style and types
# make bench  speed, as ratios within one run
# make docs   the documentation site, into out/site/ (after make ci-packages)
# Everything is installed into .venv, from pinned versions, and again only when the pins change.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
COMPILE := $(BIN)/pip-compile --quiet --upgrade --strip-extras --no-header --no-emit-index-url --no-emit-find-links --no-emit-trusted-host
JOBS ?= 2

.PHONY: demo test lint bench docs pictures pins ci-packages data clean

demo: $(VENV)/.ready
	$(BIN)/calib fit urdf/medrue.yaml docs/examples/medrue_simulated.csv --validate 0.8 --out out/demo

test: $(VENV)/.ready
	$(BIN)/python -m pytest -n $(JOBS)

lint: $(VENV)/.ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(VENV)/.ready
	$(BIN)/python -m pytest tests/benchmarks --benchmark-enable --benchmark-only -n 0 -s

# The pictures of README and docs, from a fresh demo.
pictures: demo
	$(BIN)/python -m viz.screenshots out/demo --out docs/figures

# Needs the extra `docs`: make ci-packages.
docs: $(VENV)/.ready
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict -f docs/site/mkdocs.yml

# The shipped measurement file, written again (a test compares it).
data: $(VENV)/.ready
	$(BIN)/python -m medrue.simulated_measurements docs/examples/medrue_simulated.csv

# New pins from pyproject.toml: for every set-up, and with the optional tools that continuous integration uses too.
pins: $(VENV)/.ready
	$(COMPILE) --extra dev --output-file requirements.txt pyproject.toml
	$(COMPILE) --all-extras --constraint requirements.txt --output-file requirements-ci.txt pyproject.toml

ci-packages: $(VENV)/.ready
	$(PIP) -r requirements-ci.txt

$(VENV)/.ready: pyproject.toml requirements.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed: make PYTHON=..." >&2; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) -r requirements.txt
	$(PIP) --no-deps --editable .
	@touch $@

clean:
	rm -rf out dist $(VENV)
