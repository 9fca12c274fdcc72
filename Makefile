# make demo   set up, simulate an array, track a tag in it, compare with the truth
# make check  a quick look while working: lint, types of what changed, tests without JAX's compiler
# make test   set up, lint, types, then the whole test suite and the notebooks
# make test-extended   the long tests and notebooks that make test leaves out
# make docs   the site in docs/_build/html: pages, notebooks and gallery as they run, reference
# make test-newest PYTHON=python3.13   the smoke tests on the newest of everything
# make test-oldest   the smoke tests on the lowest versions that pyproject.toml allows
# Nothing but Python 3.11+ and make is needed beforehand; everything lands in .venv, .venv-newest
# and .venv-oldest.

VENV  := .venv
BIN   := $(VENV)/bin
CORE  := $(VENV)/.core
STAMP := $(VENV)/.installed
SITE  := $(VENV)/.docs
NOTEBOOKS := $(wildcard notebooks/*.ipynb)
LONG := notebooks/array_design.ipynb notebooks/hostetter_royle.ipynb
WORKERS ?= 2
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PYRIGHT_PYTHON_IGNORE_WARNINGS := 1

.PHONY: install check test test-extended test-newest test-oldest lint pytest demo docs clean
.DELETE_ON_ERROR:

install: $(CORE)

$(BIN)/python:
	@set -e; \
	for p in python3 python3.13 python3.12 python3.11; do \
	  if "$$p" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; \
	  then python=$$p; break; fi; \
	done; \
	if [ -z "$$python" ]; then \
	  echo "maloc needs Python 3.11 or newer, and none of python3, python3.13, python3.12," \
	       "python3.11 is one: install one and run make again" >&2; exit 1; \
	fi; \
	echo "setting up $(VENV) with $$($$python --version)"; \
	"$$python" -m venv $(VENV)

# Each stamp is younger than these files exactly when what they ask for is installed: what users
# need, and with it what the tests need.
$(CORE): pyproject.toml constraints.txt maloc/_package/version.py | $(BIN)/python
	PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet -c constraints.txt -e .
	@touch $(CORE)

$(STAMP): pyproject.toml constraints.txt maloc/_package/version.py | $(BIN)/python
	PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet -c constraints.txt -e '.[test]'
	@touch $(CORE) $(STAMP)

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/deptry maloc models benchmarks simulations
	$(BIN)/deptry tests notebooks docs --ignore DEP002,DEP004
	$(BIN)/lint-imports --no-logo --no-cache
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(if $(NOTEBOOKS),$(BIN)/nbstripout --verify $(NOTEBOOKS))

# Most of the suite's time is XLA's compiler's, so make test has it take the short way. As users
# have it, it compiles in the processes that maloc starts itself (maloc/runs/threads.py), in
# make test-extended, test-newest and test-oldest, and under a bare pytest.
QUICK := --xla_cpu_multi_thread_eigen=false --xla_backend_optimization_level=0 \
  --xla_cpu_use_fusion_emitters=false

pytest: export XLA_FLAGS := $(QUICK)
pytest: $(STAMP)
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m 'not extended' --ignore tests/smoke \
	  --nbmake --nbmake-timeout=300 tests $(filter-out $(LONG),$(NOTEBOOKS))

# Of what differs from the commit BASE: a folder's types are checked together.
BASE ?= HEAD
CHANGED = $(shell git diff --name-only --diff-filter=d $(BASE) -- 'maloc/*.py' 'models/*.py' \
  'tests/*.py'; git ls-files --others --exclude-standard -- 'maloc/*.py' 'models/*.py' 'tests/*.py')

check: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(if $(CHANGED),$(BIN)/pyright --pythonpath $(BIN)/python $(sort $(dir $(CHANGED))))
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m 'not extended and not compiles' \
	  --ignore tests/smoke tests

test-extended: $(STAMP)
	$(BIN)/python -m pytest -n $(WORKERS) -m extended --ignore tests/smoke tests
	$(BIN)/python -m pytest -n $(WORKERS) --nbmake --nbmake-timeout=600 $(LONG)

# side by side: one core would idle while the types are checked
test: $(STAMP)
	@rm -f $(VENV)/.passed
	@$(MAKE) --no-print-directory -j2 lint pytest
	@touch $(VENV)/.passed

# The legs: what a user does, from a raw export to every output, and the tests of whatever leans on
# an optional dependency. Deprecations are errors on the newest versions; the oldest have their own.
SMOKE := tests/smoke tests/export/test_export.py tests/readers/test_formats.py tests/world/test_habitat.py::test_water_of_a_raster \
  tests/emitters/test_tracking.py tests/classical/test_kalman.py
SMOKE_TOOLS := 'pytest>=8' 'hypothesis>=6.100'
DEPRECATED := DeprecationWarning PendingDeprecationWarning FutureWarning
PYTHON ?= python3
empty :=
comma := ,
joined = $(subst $(empty) $(empty),$(comma),$(strip $(1)))
OLDEST_PYTHON ?= python3.11

test-newest:
	@set -e; new=.venv-newest; said=$$($(PYTHON) --version); \
	if [ "$$($$new/bin/python --version 2>/dev/null)" != "$$said" ]; then \
	  echo "setting up $$new with $$said"; $(PYTHON) -m venv --clear $$new; fi; \
	rm -f $$new/.passed; \
	$$new/bin/python -m pip install --quiet --upgrade --upgrade-strategy eager \
	  -e '.[all]' $(SMOKE_TOOLS); \
	PYTHONWARNINGS=$(call joined,$(DEPRECATED:%=error::%)) $$new/bin/python -m pytest $(SMOKE); \
	touch $$new/.passed

# set up anew each time: what is installed already would not be taken down to its lower bound
test-oldest:
	@set -e; old=.venv-oldest; \
	echo "setting up $$old with $$($(OLDEST_PYTHON) --version)"; \
	$(OLDEST_PYTHON) -m venv --clear $$old; \
	$$old/bin/python -m pip install --quiet --upgrade uv; \
	VIRTUAL_ENV=$$old $$old/bin/uv pip install --quiet --resolution lowest-direct \
	  --only-binary :all: --no-binary maloc -e '.[all]' $(SMOKE_TOOLS); \
	$$old/bin/python -m pytest $(DEPRECATED:%=-W ignore::%) $(SMOKE); \
	touch $$old/.passed

TRACK = $(BIN)/maloc track --receivers demo/data/receivers.csv --interval 20.6 36.6 --quiet

demo: $(CORE)
	@rm -rf demo
	$(BIN)/maloc simulate demo/data --scenario canal --seed 1
	$(TRACK) --toa demo/data/toa.csv --out demo/track-toa
	$(TRACK) demo/data/detections.csv --tag 1001 --out demo/track
	@echo
	@$(BIN)/python -m benchmarks.compare demo/data/truth.csv demo/track-toa demo/track \
	  --receivers demo/data/receivers.csv --picture demo/track.png
	@echo "demo/data       what was simulated, with its truth"
	@echo "demo/track-toa  the track from arrival times on the true clock"
	@echo "demo/track      the track from raw detections, clocks synchronised on the way: track.csv,"
	@echo "                arrivals.csv, parameters.csv, posterior.nc, map.png, diagnostics.png"

$(SITE): $(STAMP)
	PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet -c constraints.txt -e '.[docs]'
	@touch $(SITE)

# Executed cells call maloc by its name; nothing is fetched, and a warning is an error.
docs: $(SITE)
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/python -m sphinx -W --keep-going -q docs docs/_build/html
	@echo "docs/_build/html/index.html"

clean:
	rm -rf $(VENV) docs/_build docs/_generated .venv-newest .venv-oldest build dist demo .cache .pytest_cache .ruff_cache .hypothesis *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
