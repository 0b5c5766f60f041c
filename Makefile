# `make validate` and `make test` need Python >= 3.11 and nothing else; `make help` lists the rest.

PYTHON ?= python3
JOBS ?= auto
ARGS ?=

BIN := .venv/bin
# An environment contains the path of its folder: in a copied or moved tree it would run the code of the old
# one. So the stamps carry a number made of the folder's name, and a copy makes its own environment.
HERE := $(shell pwd -P | cksum | cut -d' ' -f1)
LOCKED := .venv/locked-$(HERE)
INSTALLED := .venv/installed-$(HERE)
SITE_TOOLS := .venv/site-tools-$(HERE)

# Without bytecode every process would compile every module that it loads: tests start hundreds.
unexport PYTHONPATH PYTHONHOME PYTHONDONTWRITEBYTECODE
.DELETE_ON_ERROR:
.PHONY: help install validate test slow lint docs site stress bench scoreboard guard wheel fuzz faults isa hostile mutants nightly clean

help: ## this list
	@echo 'make TARGET [PYTHON=python3.12] [JOBS=N] [ARGS="options of the command behind it"]'
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/  \1~\2/p' Makefile | tr '~' '\t' | expand -t 12

install: $(INSTALLED) ## the environment alone: .venv with exactly what requirements.lock names

validate: $(INSTALLED) ## compare every scene of scenes/ with Mitsuba; THOROUGH=1 also tests what their films do not use
	@$(BIN)/mitsuba-ref validate scenes $(if $(THOROUGH),--thorough) $(ARGS)

test: $(INSTALLED) ## every test but further cases of slow ones, on JOBS cores (all of them, unless set)
	@$(BIN)/python -m pytest -n $(JOBS) --dist worksteal -m 'not slow' $(ARGS)

slow: $(INSTALLED) ## the tests that `make test` leaves out; with it, each test has been run
	@$(BIN)/python -m pytest -n $(JOBS) --dist worksteal -m slow $(ARGS)

fuzz: $(INSTALLED) ## random scenes against exact arithmetic and Mitsuba for a minute; ARGS="--time 1h --seed 7"
	@$(BIN)/mitsuba-ref fuzz $(ARGS)

faults: $(INSTALLED) ## plant every fault of tests/faults in a copy of the tree: validate, fuzz or a test has to find each
	@FAULTS=all $(BIN)/python -m pytest -n $(JOBS) tests/reference/test_faults.py $(ARGS)

isa: $(INSTALLED) ## scenes and tests with Mitsuba limited to SSE4.2, AVX and AVX2, as other machines have it; half an hour
	@PYTHONPATH=tests/isa $(BIN)/python -P -m isa_runs --jobs $(JOBS) $(ARGS)

mutants: $(INSTALLED) ## plant small faults by rule, a sample of each group of modules: writes docs/internals/mutants.md; hours
	@PYTHONPATH=benchmarks:tests/reference:tests $(BIN)/python -P -m mutants --page docs/internals/mutants.md $(ARGS)

hostile: $(INSTALLED) ## a thousand broken and hostile inputs to every command: none may crash, hang or leave anything
	@PYTHONPATH=tests/hostile:tests $(BIN)/python -P -m hostile_runs --count 1000 $(ARGS)

nightly: $(INSTALLED) slow faults isa hostile ## what make test has no time for: all faults, half an hour of hard rays, 12 million at edges and corners
	@$(BIN)/mitsuba-ref fuzz --rays 2000 --time 30m
	@$(BIN)/mitsuba-ref stress watertight --rays 1000000
	@PYTHONPATH=benchmarks:tests/reference:tests $(BIN)/python -P -m mutants --seed $$(date +%j) --out build/mutants-nightly

lint: $(INSTALLED) ## style, format and types: ruff, mypy
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

stress: $(INSTALLED) ## sweeps of numerical stability: writes docs/internals/stress.md and its pictures, in a few minutes
	@mkdir -p build
	@$(BIN)/mitsuba-ref stress --json build/stress.json $(ARGS); code=$$?; \
	  $(BIN)/python benchmarks/stress_page.py build/stress.json docs/internals && exit $$code

bench: $(INSTALLED) ## run time against error: writes docs/internals/performance.md and its plot
	@mkdir -p docs/internals/performance
	@$(BIN)/mitsuba-ref bench --json docs/internals/performance/run.json $(ARGS)
	@$(BIN)/python benchmarks/performance_page.py docs/internals/performance/run.json docs/internals

scoreboard: $(INSTALLED) ## thirty published ray casters on hard rays: writes docs/findings/scoreboard.md; installs them into build; half an hour
	@PYTHONPATH=benchmarks $(BIN)/python -P -m scoreboard $(ARGS)

wheel: $(INSTALLED) ## a wheel with object code of all kernels for x86-64-v3: dist/, in some minutes
	@$(BIN)/python .ci/wheel_with_kernels.py $(ARGS)

docs: $(INSTALLED) ## pages and pictures that are made from sources: API, packages, an edge case, every shape, scenes
	@$(BIN)/python docs/api.py
	@$(BIN)/python docs/architecture.py
	@$(BIN)/python docs/method_pixel.py
	@$(BIN)/python docs/console.py docs/quick-start.md docs/debugging.md
	@$(BIN)/python docs/scenes.py

site: $(SITE_TOOLS) ## docs/ as a site that can be searched, with a page a command and a report to try: build/site
	@$(BIN)/python -P docs/build_site.py $(ARGS)

guard: $(INSTALLED) ## whether this tree renders slower than commit BASE did: fails beyond 1.25 times as long
	@test -n "$(BASE)" || { echo 'which commit? make guard BASE=HEAD~1' >&2; exit 2; }
	@$(BIN)/python benchmarks/revisions.py "$(BASE)" $(ARGS)

clean: ## remove .venv and everything else that was made here; caches in the home folder stay
	rm -rf .venv build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name .git -prune -o -type d -name __pycache__ -prune -exec rm -rf {} +

$(LOCKED): requirements.lock
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo 'Python 3.11 or newer is needed; name one: make PYTHON=python3.12 $(MAKECMDGOALS)' >&2; exit 1; }
	@"$(PYTHON)" -c 'import ensurepip, venv' 2>/dev/null || \
	  { echo 'This Python cannot make virtual environments; on Debian and Ubuntu: apt install python3-venv' >&2; exit 1; }
	@echo 'Installing requirements.lock into .venv: once, some 290 MB to download, 910 MB on disk' >&2
	@"$(PYTHON)" -m venv --clear .venv
	@$(BIN)/python -m pip install -q --disable-pip-version-check --require-hashes -r requirements.lock
	@touch $@

$(INSTALLED): $(LOCKED) pyproject.toml
	@$(BIN)/python -m pip install -q --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

$(SITE_TOOLS): $(INSTALLED)
	@$(BIN)/python -m pip install -q --disable-pip-version-check --no-build-isolation -e '.[site]'
	@touch $@
