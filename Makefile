# Every target does its own set-up: .venv is created from requirements.lock on first use and again when the lock,
# pyproject.toml or the repository's location changes.

BIN := .venv/bin
READY := .venv/.ready
PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check

# A target for each study, by the name that its folder gives it.
named = $(shell sed -n '/^STUDY = Study(/,/^)/s/.*\bname="\([a-z_]*\)".*/\1/p' $(1))
STUDIES := $(filter-out check,$(call named,afl_mujoco/studies/*.py)) # make check is that of the code
QUICK = $(call named,$(shell grep -l 'quick: bool' afl_mujoco/studies/*.py))

.DEFAULT_GOAL := help
.PHONY: $(STUDIES) help setup plant validate proof robustness render view report docs results dist test slow regression baselines pinocchio cluster tune readings claims bench faults mutants check lock clean distclean

help: ## list the targets
	@sed -n 's/^\([a-z]*\):.*## /  make \1\t/p' $(MAKEFILE_LIST) | expand -t 18
	@echo "  make NAME       run a study, its options as ARGS=\"...\": $(STUDIES)"

setup: $(READY) ## create .venv (every other target does so by itself)

validate: $(READY) ## compare MuJoCo with the analytic model on every case; options as ARGS="..."

plant: $(READY) ## check an MJCF against its equations; ARGS="examples/quadrotor_load.py:plant"
	@$(BIN)/afl-mujoco check $(ARGS)

proof: $(READY) ## validate, with refinement studies, ledgers, and the effect of what the paper omits
	@$(BIN)/afl-mujoco validate --full --out renders/proof $(ARGS)

render: $(READY) ## film every scenario with both controllers, and both side by side (10 minutes); options as ARGS="..."
	@$(BIN)/afl-mujoco render $(ARGS)

view: $(READY) ## show a run in MuJoCo's interactive viewer, in real time; ARGS="step-step --controller fixed"
	@$(BIN)/afl-mujoco view $(ARGS)

report: $(READY) ## make renders/validation/report.html again from the results there, with the films of make render
	@$(BIN)/afl-mujoco report $(ARGS)

$(STUDIES): $(READY)
	@$(BIN)/afl-mujoco $@ $(ARGS)

robustness: ## run every study of robustness: what happens if the loop is not ideal (30 minutes; ARGS="--quick": 5)
	@for study in $(QUICK); do $(MAKE) --no-print-directory $$study || exit; done

docs: $(READY) ## make the pages of docs/ and README.md that have templates, and the site in docs/_build/html (2 minutes)
	@$(PIP_INSTALL) --no-deps --requirement requirements-docs.lock
	@$(BIN)/python -m docs.content
	@$(BIN)/sphinx-build --fresh-env --fail-on-warning --keep-going --quiet -b html docs docs/_build/html $(ARGS)
	@echo "the site is in docs/_build/html/index.html"

results: $(READY) ## make the results anew that the site rests on (an hour), or ARGS="--list", "--cheap --check", "margins"
	@$(BIN)/python docs/make_results.py $(ARGS)

dist: $(READY) ## build wheel and source distribution into dist/, check them, and install the wheel in an empty environment
	@$(PIP_INSTALL) --no-deps --requirement requirements-docs.lock
	$(require_python)
	@rm -rf dist
	@$(BIN)/python -m build --no-isolation --outdir dist . >/dev/null
	@$(BIN)/twine check --strict dist/*
	@set -e; fresh=$$(mktemp -d); trap 'rm -rf "$$fresh"' EXIT; \
	$(python) -m venv "$$fresh/venv"; \
	"$$fresh/venv/bin/python" -m pip install --quiet --disable-pip-version-check dist/*.whl; \
	"$$fresh/venv/bin/python" -c 'import sys; sys.exit(sys.version_info >= (3, 13))' \
	|| "$$fresh/venv/bin/python" -m pip install --quiet --no-deps "dm-control>=1.0.50,<1.1"; \
	cd "$$fresh" && venv/bin/afl-mujoco validate nominal --no-page --out out

test: $(READY) ## run the tests except the slow ones, or exactly those of ARGS="tests/plant -k energy"
	@$(BIN)/pytest -q -n logical --maxprocesses 4 $(or $(ARGS),-m "not slow")

slow: $(READY) ## run the slow tests: whole commands, films, the page in a browser
	@$(BIN)/pytest -q -n logical --maxprocesses 4 -m slow $(ARGS)

regression: $(READY) ## compare every run with its baseline
	@$(BIN)/afl-mujoco regression $(ARGS)

baselines: $(READY) ## make the current state the baselines, and print what changed
	@$(BIN)/afl-mujoco regression --update $(ARGS)

pinocchio: $(READY) ## compare MuJoCo's dynamics with a second engine, Pinocchio
	@$(PIP_INSTALL) --no-deps --requirement requirements-pinocchio.lock
	@AFL_MUJOCO_REQUIRE_PINOCCHIO=1 $(BIN)/pytest -q tests/studies/verify/test_second_engine.py $(ARGS)

cluster: $(READY) ## test a Dask cluster that shares work among its workers, one of which dies
	@$(PIP_INSTALL) --no-deps --requirement requirements-cluster.lock
	@AFL_MUJOCO_REQUIRE_CLUSTER=1 $(BIN)/pytest -q tests/execution/test_dask_cluster.py $(ARGS)

tune: $(READY) ## search the gain table and fit the gain functions with the paper's full setting (an hour at most); ARGS="--quick"
	@$(BIN)/python -m research.tune --resume $(ARGS)

readings: $(READY) ## find under which readings of the paper its numbers hold (25 minutes; ARGS="--quick --out DIR": 2)
	@$(BIN)/python -m research.readings $(ARGS)

claims: $(READY) ## judge anew what validate takes as shipped: C9 to C12, and readings for C3 to C6
	@$(BIN)/python -m research.claims

bench: $(READY) ## measure speed, as ratios: the loop, the batch integrator, the optimisers, the gain functions, the films, many runs, maps (25 minutes)
	@$(BIN)/python benchmarks/bench_rollout.py
	@$(BIN)/python benchmarks/bench_batch.py
	@$(BIN)/python -m research.optimisers --out renders/bench
	@$(BIN)/python benchmarks/bench_gain_functions.py
	@$(BIN)/python benchmarks/bench_render.py
	@$(BIN)/python benchmarks/bench_montecarlo.py

faults: $(READY) ## plant physical faults one at a time and see which check catches each (15 minutes)
	@$(BIN)/python tests/planted_faults.py $(ARGS)

mutants: $(READY) ## plant a sample of the faults that Cosmic Ray can think of, and see how many are noticed (an hour)
	@$(PIP_INSTALL) --no-deps --requirement requirements-mutants.lock
	@$(BIN)/python tests/mutants.py $(ARGS)

check: $(READY) ## format, lint, types, import contracts, architecture
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports --no-logo
	@$(BIN)/pytest -q tests/architecture

clean: ## remove caches, build products and everything in renders/
	@rm -rf build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache MUJOCO_LOG.TXT
	@find . -name __pycache__ -not -path './.venv/*' -prune -exec rm -rf {} +
	@find renders -mindepth 1 -maxdepth 1 -not -name README.md -exec rm -rf {} +

distclean: clean ## clean, and remove .venv too
	@rm -rf .venv

lock: PYTHON ?= python3.11# the oldest: newer versions run what it can run
lock: ## resolve the newest versions that pyproject.toml allows into requirements.lock, with the hashes of their archives
	$(require_python)
	@set -e; fresh=$$(mktemp -d); trap 'rm -rf "$$fresh"' EXIT; \
	$(python) -m venv "$$fresh"; \
	"$$fresh/bin/python" -m pip install --quiet --upgrade pip setuptools; \
	"$$fresh/bin/python" -m pip install --quiet --group dev --editable .; \
	frozen() { "$$fresh/bin/python" -m pip freeze --all --exclude-editable --exclude pip | sed "s/^labmaze.*/& ; python_version < '3.13'/"; }; \
	{ grep '^#' requirements.lock; frozen; } > "$$fresh/lock"; \
	"$$fresh/bin/python" -m pip install --quiet --group dev --group dist --editable '.[docs]'; \
	{ grep '^#' requirements-docs.lock; frozen | grep -vxFf "$$fresh/lock"; } > "$$fresh/lock-docs"; \
	cp "$$fresh/lock" requirements.lock; cp "$$fresh/lock-docs" requirements-docs.lock; \
	"$$fresh/bin/python" .ci/hashes.py requirements*.lock

# The stamp is written last and holds the repository's path: an interrupted set-up or a moved repository starts over.
ifneq ($(shell cat $(READY) 2>/dev/null),$(CURDIR))
.PHONY: $(READY)
endif

$(READY): requirements.lock pyproject.toml
	$(require_python)
	@echo "set-up: creating .venv with $$($(python) --version) (first run only, 1-2 minutes)"
	@rm -rf .venv
	@$(python) -m venv .venv
	@$(PIP_INSTALL) --no-deps --requirement requirements.lock
	@$(PIP_INSTALL) --no-deps --no-build-isolation --editable .
	@report=$$($(BIN)/python -m pip check) || [ -z "$$(echo "$$report" | grep -v 'requires labmaze')" ] || { echo "$$report" >&2; exit 1; }
	@echo "$(CURDIR)" > $@

# The first candidate that runs (a shim may not), is 3.11 to 3.14 and can create environments; else "!" and what was found.
FIND_PYTHON = \
  for candidate in $(or $(PYTHON),python3.12 python3.11 python3.13 python3.14 python3 python); do \
    path=$$(command -v $$candidate) || { [ -z "$(PYTHON)" ] || found="$$found, $$candidate (not there)"; continue; }; \
    version=$$("$$path" -c 'import sys; print("%d.%d.%d" % sys.version_info[:3])' 2>/dev/null) || version="(does not run)"; \
    case "$$version" in 3.11.*|3.12.*|3.13.*|3.14.*) \
      if "$$path" -c 'import venv, ensurepip' 2>/dev/null; then echo "$$path"; exit; fi; \
      version="$$version (without venv and ensurepip)";; \
    esac; \
    found="$$found, $$candidate $$version"; \
  done; \
  found="$${found\#, }"; \
  echo "! afl_mujoco needs Python 3.11 to 3.14, found: $${found:-none}; install one or run make PYTHON=/path/to/python3.12"

python = $(eval python := $(shell found=; $(FIND_PYTHON)))$(python)
require_python = $(if $(filter !,$(python)),$(error $(wordlist 2,99,$(python))))
