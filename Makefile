# make demo   set up, simulate an array, track a tag in it, compare with the truth
# make test   set up, lint, types, then the whole test suite and the notebooks
# make test-extended   the long tests and notebooks that make test leaves out
# make docs   the site in docs/_build/html: pages, notebooks and gallery as they run, reference
# Nothing but Python 3.11+ and make is needed beforehand; everything lands in .venv.

VENV  := .venv
BIN   := $(VENV)/bin
STAMP := $(VENV)/.installed
SITE  := $(VENV)/.docs
NOTEBOOKS := $(wildcard notebooks/*.ipynb)
LONG := notebooks/array_design.ipynb notebooks/hostetter_royle.ipynb
WORKERS ?= 2
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PYRIGHT_PYTHON_IGNORE_WARNINGS := 1

.PHONY: install test test-extended lint pytest demo docs clean
.DELETE_ON_ERROR:

install: $(STAMP)

# The stamp is younger than both files exactly when what they ask for is installed.
$(STAMP): pyproject.toml constraints.txt
	@set -e; \
	if [ ! -x $(BIN)/python ]; then \
	  for p in python3 python3.13 python3.12 python3.11; do \
	    if "$$p" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; \
	    then python=$$p; break; fi; \
	  done; \
	  if [ -z "$$python" ]; then \
	    echo "maloc needs Python 3.11 or newer, and none of python3, python3.13, python3.12," \
	         "python3.11 is one: install one and run make again" >&2; exit 1; \
	  fi; \
	  echo "setting up $(VENV) with $$($$python --version)"; \
	  "$$python" -m venv $(VENV); \
	fi
	PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet -c constraints.txt -e '.[test]'
	@touch $(STAMP)

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(if $(NOTEBOOKS),$(BIN)/nbstripout --verify $(NOTEBOOKS))

pytest: $(STAMP)
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m 'not extended' \
	  --nbmake --nbmake-timeout=300 tests $(filter-out $(LONG),$(NOTEBOOKS))

test-extended: $(STAMP)
	$(BIN)/python -m pytest -n $(WORKERS) -m extended tests
	$(BIN)/python -m pytest -n $(WORKERS) --nbmake --nbmake-timeout=600 $(LONG)

# side by side: one core would idle while the types are checked
test: $(STAMP)
	@$(MAKE) --no-print-directory -j2 lint pytest

TRACK = $(BIN)/maloc track --receivers demo/data/receivers.csv --interval 20.6 36.6 --quiet

demo: $(STAMP)
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
	rm -rf $(VENV) docs/_build docs/_generated build dist demo .cache .pytest_cache .ruff_cache .hypothesis *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
