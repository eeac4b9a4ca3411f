# Needs Python 3.11 to 3.13, make and a package index. No root, nothing outside this folder.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
RUNNABLE := $(VENV)/.runnable
JOBS ?= 2
SECONDS ?= 600
SEED ?= 0

check-python = $(PYTHON) -c 'import sys; sys.exit(None if (3, 11) <= sys.version_info < (3, 14) else \
	"quadlog needs Python 3.11, 3.12 or 3.13; try: make PYTHON=python3.12 $(MAKECMDGOALS)")'

.PHONY: demo tables test test-all install lint typecheck unit bench fuzz docs fixture clean

demo: $(RUNNABLE)  ## replay the committed recording, print its verdict and where its page is
	@echo "demo: replaying fixtures/follow.mcap, 12 s of a synthetic walk; the first time compiles for some 20 s"
	@$(BIN)/quadlog replay fixtures/follow.mcap -c fixtures/follow.toml -o runs --force

tables: install  ## the papers' tables beside ours, into tables/; FAST=1 draws less; what is there and unchanged is kept
	$(BIN)/quadlog tables -o tables --force $(if $(filter-out 0,$(FAST)),--fast)

test: install lint typecheck unit  ## everything a change must pass

test-all: install lint typecheck  ## with the nightly tests, and 500 examples of each property; takes an hour
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal -m "" --hypothesis-profile nightly

install: $(INSTALLED)

# With the tools of lint and tests, which the demo does without.
$(INSTALLED): pyproject.toml
	$(check-python)
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@ $(RUNNABLE)

$(RUNNABLE): pyproject.toml
	@$(check-python)
	@echo "demo: installing quadlog and its packages into $(VENV): 270 MB to download, 1.6 GB on disk, 1 to 3 minutes"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --disable-pip-version-check --progress-bar off --editable .
	@touch $@

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

typecheck: install
	$(BIN)/mypy -p quadlog

unit: install
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal

bench: install  ## the figures the README quotes, with limit and floor beside each; PARTS=perception measures less
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]'
	$(BIN)/python -m benchmarks $(PARTS)

fuzz: install  ## damaged and hostile inputs for SECONDS=600, guided by coverage where atheris has a wheel; SEED=0, TARGETS=
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --only-binary :all: atheris || true
	$(BIN)/python -m fuzzing --seconds $(SECONDS) --seed $(SEED) $(TARGETS)

docs: install  ## write the pages of docs/ again that say what the code says
	$(BIN)/python docs/make.py

fixture: install  ## make the committed recording again, byte for byte
	$(BIN)/python fixtures/make.py

clean:
	rm -rf $(VENV) .mypy_cache .pytest_cache .ruff_cache .fuzz runs build *.egg-info
