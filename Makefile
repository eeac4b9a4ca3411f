# Needs Python >= 3.11, make and a package index. No root, nothing outside this folder.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
JOBS ?= 2
SECONDS ?= 600
SEED ?= 0

.PHONY: demo tables test install lint typecheck unit bench fuzz docs fixture clean

demo: install  ## replay the committed recording and print its metrics
	$(BIN)/quadlog replay fixtures/follow.mcap -c fixtures/follow.toml -o runs --force

tables: install  ## the papers' tables beside ours, into tables/; FAST=1 draws less; what is there and unchanged is kept
	$(BIN)/quadlog tables -o tables --force $(if $(filter-out 0,$(FAST)),--fast)

test: install lint typecheck unit  ## everything a change must pass

install: $(INSTALLED)

$(INSTALLED): pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(None if sys.version_info >= (3, 11) else "quadlog needs Python 3.11 or later; try: make PYTHON=python3.12 $(MAKECMDGOALS)")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

# cli/ and pipelines/ are installed inside quadlog; the type checker sees that through links.
typecheck: install
	rm -rf .typing && mkdir -p .typing/quadlog
	for each in quadlog/*; do ln -s "../../$$each" ".typing/$$each"; done
	ln -s ../../cli .typing/quadlog/cli
	ln -s ../../pipelines .typing/quadlog/pipelines
	$(BIN)/mypy -p quadlog

unit: install
	$(BIN)/python -m pytest -n $(JOBS) --dist worksteal

bench: install  ## the figures the README quotes, with limit and floor beside each; PARTS=perception measures less
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]'
	$(BIN)/python -m benchmarks $(PARTS)

fuzz: install  ## damaged and hostile inputs for SECONDS=600, guided by coverage where atheris has a wheel; SEED=0, TARGETS=
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[fuzz]'
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --only-binary :all: atheris || true
	$(BIN)/python -m fuzzing --seconds $(SECONDS) --seed $(SEED) $(TARGETS)

docs: install  ## write the pages of docs/ again that say what the code says
	$(BIN)/python docs/make.py

fixture: install  ## make the committed recording again, byte for byte
	$(BIN)/python fixtures/make.py

clean:
	rm -rf $(VENV) .typing .mypy_cache .pytest_cache .ruff_cache .fuzz runs build *.egg-info
