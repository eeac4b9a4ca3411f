# Needs Python 3.11 to 3.13, make and a package index. No root, nothing outside this folder.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
INSTALLED := $(VENV)/.installed
RUNNABLE := $(VENV)/.runnable
# The versions to install; `make install LOCK=` takes the newest that pyproject.toml allows.
LOCK ?= requirements.lock
LOCKED = $(LOCK:%=--constraint=%) $(LOCK:%=--build-constraint=%)
GROUPS := --group lint --group tests --group docs
JOBS ?= 2
SECONDS ?= 600
SEED ?= 0

check-python = $(PYTHON) -c 'import sys; sys.exit(None if (3, 11) <= sys.version_info < (3, 14) else \
	"quadlog needs Python 3.11, 3.12 or 3.13; try: make PYTHON=python3.12 $(MAKECMDGOALS)")'

.PHONY: demo tables test test-all install lint typecheck unit bench fuzz docs fixture package lock clean

demo: $(RUNNABLE)  ## replay the committed recording, print its verdict and where its page is
	@echo "demo: replaying fixtures/follow.mcap, 12 s of a synthetic walk; the first time compiles for some 20 s"
	@$(BIN)/quadlog replay fixtures/follow.mcap -c fixtures/follow.toml -o runs --force

tables: install  ## the papers' tables beside ours, into tables/; FAST=1 draws less
	$(BIN)/quadlog tables -o tables --force $(if $(filter-out 0,$(FAST)),--fast)

test: install lint typecheck unit  ## everything a change must pass

test-all: install lint typecheck  ## with the nightly tests, and 500 examples of each property; takes half an hour
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal -m "" --hypothesis-profile nightly

install: $(INSTALLED)  ## quadlog with what lint, tests and docs need

$(INSTALLED): $(VENV)/.pip pyproject.toml $(LOCK)
	$(PIP) install --quiet $(LOCKED) $(GROUPS) --editable .
	touch $@ $(RUNNABLE)

$(RUNNABLE): $(VENV)/.pip pyproject.toml $(LOCK)
	@echo "demo: installing quadlog and its packages into $(VENV): 410 MB to download, 1.6 GB on disk, 1 to 3 minutes"
	@$(PIP) install --quiet --progress-bar off $(LOCKED) --editable .
	@touch $@

# Older ones, such as those that come with Python 3.11, know neither groups nor build constraints.
$(VENV)/.pip:
	@$(check-python)
	@echo "making $(VENV)"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(PIP) install --quiet --upgrade 'pip>=25.3'
	@touch $@

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

typecheck: install
	$(BIN)/mypy -p quadlog

unit: install
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal

bench: install  ## the figures the README quotes, with limit and floor beside each; PARTS=perception measures less
	$(PIP) install --quiet $(LOCKED) --group bench
	$(BIN)/python -m benchmarks $(PARTS)

fuzz: install  ## damaged and hostile inputs for SECONDS=600, guided by coverage where atheris has a wheel; SEED=0, TARGETS=
	$(PIP) install --quiet --only-binary :all: atheris || true
	$(BIN)/python -m fuzzing --seconds $(SECONDS) --seed $(SEED) $(TARGETS)

docs: install  ## write the pages of docs/ again that say what the code says, and build all of them as a site, site/index.html
	$(BIN)/python docs/make.py site

fixture: install  ## make the committed recording again, byte for byte
	$(BIN)/python fixtures/make.py

package: $(VENV)/.pip  ## sdist and wheel into dist/; the wheel runs the demo from an empty environment, newest versions
	rm -rf dist build
	$(PIP) install --quiet $(LOCKED) --group package
	$(BIN)/python -m build --outdir dist .
	$(PYTHON) -m venv build/empty
	build/empty/bin/python -m pip install --quiet --disable-pip-version-check dist/*.whl
	cd build/empty && bin/python -m pip check && bin/quadlog --version
	cd build/empty && bin/quadlog replay ../../fixtures/follow.mcap -c ../../fixtures/follow.toml -o runs

lock: $(VENV)/.pip  ## requirements.lock again: the newest versions that pyproject.toml allows, for every platform
	$(PIP) install --quiet --upgrade uv
	$(BIN)/uv pip compile pyproject.toml --universal --python-version 3.11 --all-extras $(GROUPS) --group bench \
		--group package --no-header --no-annotate --no-emit-index-url --upgrade -o requirements.lock

clean:
	rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache .fuzz runs build dist site *.egg-info
