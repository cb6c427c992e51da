# Every target does all the set-up it needs: Python 3.11 (with venv) and make are enough.
#   make demo             the main job on the shipped example: report and table in metrosep-demo/
#   make test             the tests           make test-slow   those that take long, and peers
#   make check            lint, format, types, layers, docstrings, documentation
#   make test-controller  the table on a real LinuxCNC (skipped by name where it cannot be installed)
#   make test-clients     files against other makers' clients (mecode, PIPython), likewise
#   make test-browser     the workbench in headless Chromium (skipped by name where there is none)
#   make test-notebook    its widgets in JupyterLab and marimo, driven by Chromium
#   make house           lines, files, circles of imports, what stands twice, modules that commands load
#   make bundle           wheels of metrosep and of all that it can use, for a computer without network
#   make speeds          what a hand waits for in the workbench, beside what is wanted
#   make docs | bench | constraints | clean
# Another interpreter: make PYTHON=python3.12 test

PYTHON ?= python3
VENV ?= .venv
PEERS ?= .venv-peers
CLIENTS ?= .clients
NOTEBOOK ?= .venv-notebook
DEMO ?= metrosep-demo
PYTEST_FLAGS ?=
WORKERS ?= 2

BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
PYTEST := $(BIN)/python -m pytest

# One BLAS thread: two that spin cost more than they give on small products, and sums stay the same.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
export MKL_NUM_THREADS ?= 1

.DELETE_ON_ERROR:
.PHONY: help install groups demo test test-slow test-controller test-clients test-browser test-notebook check lint lint-quick house docs speeds bench constraints bundle check-bundle clean

help:
	@sed -n 's/^#   //p' Makefile

# ---- installation; a stamp per group, so that a second call installs nothing ----------------

install: $(VENV)/.installed

$(VENV)/.created:
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if v >= (3, 11) else \
	    "metrosep needs Python 3.11 or newer, found %d.%d; call make PYTHON=python3.11" % v)'
	$(PYTHON) -m venv $(VENV)
	@$(BIN)/python -c 'import pip, sys; v = tuple(map(int, pip.__version__.split(".")[:2])); \
	    sys.exit(v < (25, 1))' || $(PIP) install --upgrade 'pip>=25.1'
	@touch $@

$(VENV)/.installed: $(VENV)/.created pyproject.toml constraints.txt
	@echo "installing metrosep and what it needs into $(VENV) (a minute or two, once)"
	$(PIP) install -c constraints.txt -e .
	@touch $@

$(VENV)/.installed-%: $(VENV)/.installed
	$(PIP) install -c constraints.txt --group $*
	@touch $@

# One after the other: pip must not write into one environment twice at a time.
groups: $(VENV)/.installed
	$(MAKE) $(VENV)/.installed-test
	$(MAKE) $(VENV)/.installed-lint
	$(MAKE) $(VENV)/.installed-docs

.SECONDARY:

# ---- what a user calls -----------------------------------------------------------------------

demo: $(VENV)/.installed
	$(BIN)/metrosep demo -o $(DEMO)
	@echo
	@echo "In $(DEMO):"
	@find $(DEMO) -type f \( -name '*.html' -o -name '*.comp' -o -name '*.csv' -o -name 'result.json' \) | LC_ALL=C sort | sed 's/^/  /'

# Modules compiled once, in $(VENV), also where the environment says that none is to be written: each
# worker and each command that a test starts would compile all of them again (half a minute each).
test test-slow: export PYTHONDONTWRITEBYTECODE =
test test-slow: export PYTHONPYCACHEPREFIX ?= $(abspath $(VENV))/pycache

# Workers take work from each other at the end; until then a fixture of a file is made once.
test: $(VENV)/.installed-test
	$(PYTEST) -n $(WORKERS) --dist worksteal $(PYTEST_FLAGS)

# ---- what a developer calls --------------------------------------------------------------------

test-slow: $(VENV)/.installed-test
	$(PYTEST) -m "(slow or peer) and not controller and not browser" $(PYTEST_FLAGS)

# install.sh ends with 75 where the package cannot be had; everything else is a failure.
test-controller: $(VENV)/.installed-test
	@status=0; bash tests/acceptance/linuxcnc/install.sh || status=$$?; \
	if [ $$status -eq 75 ]; then \
	    echo "SKIPPED linuxcnc: the package linuxcnc-uspace cannot be installed here"; exit 0; \
	fi; \
	if [ $$status -ne 0 ]; then \
	    echo "linuxcnc: install.sh failed with exit code $$status" >&2; exit $$status; \
	fi; \
	$(PYTEST) -m controller tests/acceptance/linuxcnc $(PYTEST_FLAGS)

# Clients of other makers, in a folder of their own: none of them is a dependency (PIPython's licence
# allows the use of PI devices only).
$(CLIENTS)/.installed:
	@mkdir -p $(CLIENTS)
	@if $(PIP) install --no-deps --target $(CLIENTS) mecode==0.4.1 pyserial==3.5 \
	    pyusb==1.3.1 PIPython==2.11.0.6; \
	    then touch $@; fi

test-clients: $(VENV)/.installed-test
	@$(MAKE) $(CLIENTS)/.installed
	@if [ ! -e $(CLIENTS)/.installed ]; then \
	    echo "SKIPPED clients: mecode and PIPython cannot be installed here"; exit 0; \
	fi; \
	PYTHONPATH=$(CLIENTS) $(PYTEST) -m peer tests/acceptance/mecode tests/acceptance/pi $(PYTEST_FLAGS)

# axe-core, which judges the pages; the package that brings it is not imported.
$(CLIENTS)/.axe:
	@mkdir -p $(CLIENTS)
	@if $(PIP) install --no-deps --target $(CLIENTS) axe-playwright-python==0.1.8; then touch $@; fi

# All of them; CI takes those that walk through the work of a user: BROWSER_TESTS="...".
BROWSER_TESTS ?= tests/browser
test-browser: $(VENV)/.installed-test $(CLIENTS)/.axe
	@status=0; bash tests/browser/install.sh $(BIN)/python || status=$$?; \
	if [ $$status -eq 75 ]; then \
	    echo "SKIPPED browser: Chromium cannot be installed here"; exit 0; \
	fi; \
	if [ $$status -ne 0 ]; then \
	    echo "browser: install.sh failed with exit code $$status" >&2; exit $$status; \
	fi; \
	$(PYTEST) -m browser $(BROWSER_TESTS) $(PYTEST_FLAGS)

# The widgets in JupyterLab and marimo, which live in an environment of their own.
$(NOTEBOOK)/.installed: pyproject.toml
	$(PYTHON) -m venv $(NOTEBOOK)
	$(NOTEBOOK)/bin/python -m pip --disable-pip-version-check --quiet install --upgrade 'pip>=25.1'
	$(NOTEBOOK)/bin/python -m pip --disable-pip-version-check --quiet install -c constraints.txt -e .
	$(NOTEBOOK)/bin/python -m pip --disable-pip-version-check --quiet install --group notebook-test
	@touch $@

test-notebook: $(VENV)/.installed-test $(NOTEBOOK)/.installed
	METROSEP_NOTEBOOK_PYTHON=$(abspath $(NOTEBOOK))/bin/python \
	    $(PYTEST) -m browser tests/browser/test_notebook.py $(PYTEST_FLAGS)

check: lint docs

lint: lint-quick
	$(BIN)/mypy
	$(BIN)/python tools/check_docstrings.py

# What a hand waits for in the workbench, in headless Chromium.
speeds: $(VENV)/.installed-test
	$(BIN)/python tools/bench_workbench.py

# The measures of the house; the exit code of the tool is the number of those that are missed.
house: $(VENV)/.installed
	-@$(BIN)/python tools/house.py

# What CI has time for.
lint-quick: $(VENV)/.installed-test $(VENV)/.installed-lint
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-cache

docs: $(VENV)/.installed-docs
	$(BIN)/python -m sphinx -W --keep-going -n -q -b html -d docs/_build/doctrees docs docs/_build/html
	@echo "documentation: docs/_build/html/index.html"

bench: $(VENV)/.installed-test $(VENV)/.installed-bench $(PEERS)/.installed
	$(PYTEST) -o addopts="--import-mode=importlib -s" tests/benchmarks $(PYTEST_FLAGS)
	-$(BIN)/python tools/band_coverage.py --sets 4
	-$(BIN)/python tools/run_faults.py --sets 1 --clean 60
	$(BIN)/python tools/benchmarks.py --peers $(PEERS)/bin/python

# Packages to compare with live in an environment of their own: one of them is GPL.
$(PEERS)/.installed:
	$(PYTHON) -m venv $(PEERS)
	$(PEERS)/bin/python -m pip --disable-pip-version-check --quiet install -c constraints.txt \
	    prysm==0.21.1 surfalize==0.19.2 lmfit
	@touch $@

# Pins of everything in the groups; bare names and versions, so that any registry serves them.
# A folder to carry to a computer of the same system and version of Python; README.txt says how to install it.
BUNDLE ?= metrosep-bundle
EXTRAS ?= ui,notebook,pdf,dcc,xlsx,parquet,formats,xarray

bundle: $(VENV)/.created
	rm -rf $(BUNDLE)
	mkdir -p $(BUNDLE)/wheels
	$(PIP) wheel --no-deps --wheel-dir $(BUNDLE)/wheels .
	$(PIP) download -c constraints.txt --only-binary :all: --dest $(BUNDLE)/wheels \
	    "$$(ls $(BUNDLE)/wheels/metrosep-*.whl)[$(EXTRAS)]"
	cp LICENSE README.md $(BUNDLE)/
	$(BIN)/python tools/bundle_readme.py $(BUNDLE) $(EXTRAS)
	@echo "the bundle is in $(BUNDLE); check it: make check-bundle"

# Install the bundle into a new environment without any network, and measure with it.
check-bundle:
	rm -rf $(BUNDLE)/.check
	$(PYTHON) -m venv $(BUNDLE)/.check
	$(BUNDLE)/.check/bin/python -m pip install --quiet --no-index --find-links $(BUNDLE)/wheels "metrosep[$(EXTRAS)]"
	cd $(BUNDLE) && .check/bin/metrosep doctor && .check/bin/metrosep -q demo -o .check/demo >/dev/null
	rm -rf $(BUNDLE)/.check

constraints: $(VENV)/.created
	$(PIP) install --upgrade uv
	$(BIN)/uv pip compile pyproject.toml --group test --group lint --group docs --group bench \
	    --python-version 3.11 --upgrade --no-header --no-annotate --no-emit-index-url --quiet \
	    --output-file constraints.txt

clean:
	rm -rf $(VENV) $(PEERS) $(CLIENTS) $(NOTEBOOK) $(DEMO) docs/_build docs/reference/generated .mypy_cache .ruff_cache \
	    .pytest_cache .hypothesis .import_linter_cache .benchmarks
	find metrosep tests tools docs examples data_formats -name __pycache__ -type d -prune \
	    -exec rm -rf {} + 2>/dev/null || true
