# make demo: calibrate MedRUE from the measurement file that ships with the project, into out/demo/
# make test: the tests.   make lint: style and types.   make bench: speed, as ratios within one run
# Everything is installed into .venv, from pinned versions, when pyproject.toml or requirements.txt change.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
JOBS ?= 2

.PHONY: demo test lint bench data clean

demo: $(READY)
	$(BIN)/calib fit urdf/medrue.yaml docs/examples/medrue_simulated.csv --validate 0.8 --out out/demo

test: $(READY)
	$(BIN)/python -m pytest -n $(JOBS)

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(READY)
	$(BIN)/python -m pytest tests/benchmarks --benchmark-enable --benchmark-only -n 0

# The shipped measurement file, written again (a test compares it).
data: $(READY)
	$(BIN)/python -m medrue.simulated_measurements docs/examples/medrue_simulated.csv

requirements.txt: pyproject.toml
	$(BIN)/pip-compile --quiet --strip-extras --all-extras --no-emit-index-url --no-emit-find-links --output-file $@ $<

$(READY): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed (set PYTHON=...)"; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	@touch $@

clean:
	rm -rf out dist $(VENV)
