# Every target does its own set-up: .venv is created from requirements.lock on first use and again when the lock,
# pyproject.toml or the repository's location changes.

BIN := .venv/bin
READY := .venv/.ready
INSTALL := $(BIN)/python scripts/environment.py

# A target for each study, by the name that its folder gives it.
named = $(shell awk 'FNR == 1 {on = 0} /^STUDY = / {on = 1} on && match($$0, /name="[a-z_]*"/) {print substr($$0, RSTART + 6, RLENGTH - 7)}' $(1))
STUDIES := $(filter-out check,$(call named,afl_mujoco/studies/*.py)) # make check is that of the code
QUICK = $(call named,$(shell grep -l 'quick: bool' afl_mujoco/studies/*.py))

.DEFAULT_GOAL := help
.PHONY: $(STUDIES) help setup plant validate proof robustness render view report docs results dist test slow regression baselines pinocchio cluster tune readings claims bench faults mutants check lock clean distclean

help: ## list the targets
	@sed -n 's/^\([a-z]*\):.*## /  make \1\t/p' $(MAKEFILE_LIST) | expand -t 18
	@echo "  make NAME       run a study, its options as ARGS=\"...\": $(STUDIES)"

setup: $(READY) ## create .venv (every other target does so by itself)

validate: ## compare MuJoCo with the analytic model on every case; options as ARGS="..."

plant: $(READY) ## check an MJCF against its equations; ARGS="examples/quadrotor_load.py:plant"
	@$(BIN)/afl-mujoco check $(ARGS)

proof: $(READY) ## validate, with refinement studies, ledgers, and the effect of what the paper omits
	@$(BIN)/afl-mujoco validate --full --out renders/proof $(ARGS)

render: ## film every scenario with both controllers, and both side by side (10 minutes); options as ARGS="..."
view: ## show a run in MuJoCo's interactive viewer, in real time; ARGS="step-step --controller fixed"
report: ## make renders/validation/report.html again from the results there, with the films of make render
regression: ## compare every run with its baseline
$(STUDIES) render view report regression: $(READY)
	@$(BIN)/afl-mujoco $@ $(ARGS)

robustness: ## run every study of robustness: what happens if the loop is not ideal (30 minutes; ARGS="--quick": 5)
	@for study in $(QUICK); do $(MAKE) --no-print-directory $$study || exit; done

docs: $(READY) ## make the pages of docs/ and README.md that have templates, and the site in docs/_build/html (2 minutes)
	@$(INSTALL) requirements-docs.lock
	@$(BIN)/python -m docs.content
	@$(BIN)/sphinx-build --fresh-env --fail-on-warning --keep-going --quiet -b html docs docs/_build/html $(ARGS)
	@echo "the site is in docs/_build/html/index.html"

results: $(READY) ## make the results anew that the site rests on (an hour), or ARGS="--list", "--cheap --check", "margins"
	@$(BIN)/python docs/make_results.py $(ARGS)

dist: $(READY) ## build wheel and source distribution into dist/, check them, and install the wheel in an empty environment
	@$(INSTALL) requirements-docs.lock
	@scripts/build_and_try "$$(scripts/find_python $(PYTHON))"

test: $(READY) ## run the tests except the slow ones, or exactly those of ARGS="tests/plants -k energy"
	@$(BIN)/pytest -q -n logical --maxprocesses 4 --dist worksteal $(or $(ARGS),-m "not slow")

slow: $(READY) ## run the slow tests: whole commands, films, the page in a browser
	@$(BIN)/pytest -q -n logical --maxprocesses 4 --dist worksteal -m slow $(ARGS)

baselines: $(READY) ## make the current state the baselines, and print what changed
	@$(BIN)/afl-mujoco regression --update $(ARGS)

pinocchio: $(READY) ## compare MuJoCo's dynamics with a second engine, Pinocchio
	@$(INSTALL) requirements-pinocchio.lock
	@AFL_MUJOCO_REQUIRE_PINOCCHIO=1 $(BIN)/pytest -q tests/studies/verify/test_second_engine.py $(ARGS)

cluster: $(READY) ## test a Dask cluster that shares work among its workers, one of which dies
	@$(INSTALL) requirements-cluster.lock
	@AFL_MUJOCO_REQUIRE_CLUSTER=1 $(BIN)/pytest -q tests/execution/test_dask_cluster.py $(ARGS)

tune: $(READY) ## search the gain table and fit the gain functions with the paper's full setting (an hour at most); ARGS="--quick"
	@$(BIN)/python -m research.tune --resume $(ARGS)

readings: $(READY) ## find under which readings of the paper its numbers hold (25 minutes; ARGS="--quick --out DIR": 2)
	@$(BIN)/python -m research.readings $(ARGS)

claims: $(READY) ## judge anew what validate takes as shipped: C9 to C12, and readings for C3 to C6
	@$(BIN)/python -m research.claims

bench: $(READY) ## measure speed, and say which aims hold; ARGS="rollout commands"
	@$(BIN)/python -m benchmarks $(ARGS)

faults: $(READY) ## plant physical faults one at a time and see which check catches each (15 minutes)
	@$(BIN)/python tests/planted_faults.py $(ARGS)

mutants: $(READY) ## plant a sample of the faults that Cosmic Ray can think of, and see how many are noticed (an hour)
	@$(INSTALL) requirements-mutants.lock
	@$(BIN)/python tests/mutants.py $(ARGS)

check: $(READY) ## format, lint, types, import contracts, workflows, architecture
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports --no-logo
	@$(BIN)/check-jsonschema --quiet --builtin-schema vendor.github-workflows .github/workflows/*.yml
	@$(BIN)/pytest -q tests/architecture

clean: ## remove caches, build products and everything in renders/
	@rm -rf build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache MUJOCO_LOG.TXT
	@find . -name __pycache__ -not -path './.venv/*' -prune -exec rm -rf {} +
	@find renders -mindepth 1 -maxdepth 1 -not -name README.md -exec rm -rf {} +

distclean: clean ## clean, and remove .venv too
	@rm -rf .venv

lock: $(READY) ## resolve the locks anew; with ARGS="--upgrade" to the newest versions that pyproject.toml allows
	@$(INSTALL) lock $(ARGS)

# The stamp is written last and holds the repository's path: an interrupted set-up or a moved repository starts over.
ifneq ($(shell cat $(READY) 2>/dev/null),$(CURDIR))
.PHONY: $(READY)
endif

$(READY): requirements.lock pyproject.toml scripts/environment.py
	@python=$$(scripts/find_python $(PYTHON)) || exit; \
	echo "set-up: creating .venv with $$("$$python" --version) (first run only, half a minute)"; \
	rm -rf .venv && "$$python" -m venv .venv
	@$(INSTALL) requirements.lock
	@echo "$(CURDIR)" > $@
