# make demo   calibrate MedRUE from the measurement file that ships with the project, into out/demo/
# make test   the tests
# make test-processors   the numerical tests again, with the sums of other processors
# make test-thorough   the long tests, and simulations with more draws, poses and rows
# make test-search   the tests that search for bad input, with some thousand cases
# make lint   style and types
# make bench  speed, as ratios within one run
# make docs   the documentation site, into out/site/ (after make ci-packages)
# Everything is installed into .venv, from pinned versions, and again only when the pins change: requirements.txt is what
# running needs, requirements-dev.txt has tests and linters as well, requirements-ci.txt every optional tool.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# quiet: pip says what is wrong, and nothing where it succeeds
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
COMPILE := $(BIN)/pip-compile --quiet --upgrade --strip-extras --no-header --no-emit-index-url --no-emit-find-links --no-emit-trusted-host
JOBS ?= 2

.PHONY: demo test test-processors test-thorough test-search lint bench docs pictures pins ci-packages data clean

demo: $(VENV)/.ready
	@$(BIN)/medrue demo --out out/demo

test: $(VENV)/.ready-dev
	@echo "The tests, in $(JOBS) processes. The first dots come after half a minute, the last after some minutes."
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder

test-processors: $(VENV)/.ready-dev
	$(BIN)/python -m tests.processors -n $(JOBS)

test-thorough: $(VENV)/.ready-dev
	CALIB_TESTS=thorough $(BIN)/python -m pytest -m amount -n $(JOBS) --dist worksteal

test-search: $(VENV)/.ready-dev
	CALIB_TESTS=every-case CALIB_SEARCH=200 $(BIN)/python -m pytest tests/whole/test_searched_input.py --hypothesis-seed=1 -n $(JOBS)

lint: $(VENV)/.ready-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python docs/site/name_check.py

# Prints docs/performance.md and writes it; with DATA=FOLDER also of others' measurements.
bench: $(VENV)/.ready-dev
	$(BIN)/python -m tests.benchmarks.performance $(if $(DATA),--data $(DATA)) --write docs/performance.md

# The pictures of README and docs: MedRUE as on the start page, and the map of the arm.
pictures: $(VENV)/.ready
	$(BIN)/calib fit urdf/medrue.yaml docs/examples/medrue_simulated.csv --validate 0.8 --out out/medrue --quiet
	$(BIN)/calib fit docs/examples/arm.yaml docs/examples/arm_simulated.csv --validate 0.25 --out out/arm --quiet
	$(BIN)/calib view docs/examples/arm.yaml --result out/arm --map --html out/medrue/map.html --quiet
	$(BIN)/python docs/site/screenshots.py out/medrue --out docs/figures

# Needs the extra `docs`: make ci-packages.
docs: $(VENV)/.ready
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict -f docs/site/mkdocs.yml

# The shipped measurement file, written again (a test compares it).
data: $(VENV)/.ready
	$(BIN)/python -m medrue.simulated_measurements docs/examples/medrue_simulated.csv

# New pins from pyproject.toml. Of viser, only what nothing else brings is pinned below: it bounds others' releases.
EXTRAS = $(filter-out viser,$(shell $(BIN)/python -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"])'))
pins: $(VENV)/.ready-dev
	$(COMPILE) --output-file requirements.txt pyproject.toml
	$(COMPILE) --extra dev --constraint requirements.txt --output-file requirements-dev.txt pyproject.toml
	$(COMPILE) $(addprefix --extra ,$(EXTRAS)) --constraint requirements-dev.txt --output-file requirements-ci.txt pyproject.toml

ci-packages: $(VENV)/.ready-dev
	@echo "Installing every optional tool into $(VENV): several minutes."
	@$(PIP) -r requirements-ci.txt
	@$(PIP) --no-deps robosuite==1.5.2  # its robots alone; what it imports would replace packages above
	@$(PIP) --no-deps viser==1.1.1 imageio==2.38.1 msgspec==0.23.0 tqdm==4.70.1 zstandard==0.25.0  # asks for rich < 15 and websockets < 17, and works with those above

$(VENV)/.ready: pyproject.toml requirements.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed: make PYTHON=..." >&2; exit 1; }
	@echo "Installing what running needs into $(VENV): once, some minutes."
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(PIP) -r requirements.txt
	@$(PIP) --no-deps --editable .
	@touch $@

$(VENV)/.ready-dev: $(VENV)/.ready requirements-dev.txt
	@echo "Installing tests and linters into $(VENV)."
	@$(PIP) -r requirements-dev.txt
	@touch $@

clean:
	rm -rf out dist $(VENV)
