# The two commands of a fresh machine: `make demo` and `make test`. They make .venv with Python 3.11 or newer and install
# into it; nothing else is needed, no compiler.

PYTHON ?= $(shell command -v python3.11 || command -v python3.12 || command -v python3.13 || command -v python3)
VENV   := .venv
BIN    := $(VENV)/bin
# Tests with real processes and sockets depend on what else the machine does.
RETRY  := --reruns 2
PIP    := $(BIN)/python -m pip --disable-pip-version-check install --quiet --no-compile
# Byte code of what was installed, on all cores: pip compiles on one. Old dialects of pymavlink and tests are not used.
BYTES  := $(BIN)/python -m compileall -q -j 0 -x '/(tests|v09|v10)/' \
            $$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))') > $(VENV)/compileall.log || true
# Each test process reads only files with a test of the marker.
MARKED  = $$(grep -lr --include='test_*.py' 'mark\.$(1)' tests)

.PHONY: lock messages-page help demo test test-slow test-long lint bench config-page clean

help:            ## what can be made
	@awk -F':.*## ' '/^[a-z-]+:.*## / {printf "  make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

demo: $(VENV)/.sim      ## fly through a front with the companion listening (extra `sim`; under two minutes)
	$(BIN)/kollsman-sim demo

# The estimators are compiled while the rules are checked: otherwise each test process would compile them for itself.
test: $(VENV)/.dev      ## lint, types, import rules and the default tests (extras `sim`, `dev`)
	@$(BIN)/kollsman warm-up --all & warming=$$!; \
	  $(MAKE) --no-print-directory lint || { kill $$warming; exit 1; }; wait $$warming
	$(BIN)/python -m pytest -q -n 3 $(RETRY)

test-slow: $(VENV)/.dev ## end-to-end and Monte-Carlo tests
	$(BIN)/python -m pytest -q -m "slow and not long" -n 5 $(RETRY) $(call MARKED,slow)

test-long: $(VENV)/.dev ## every scenario, hours of flight, whole recordings (half an hour)
	$(BIN)/python -m pytest -q -m long -n 2 $(RETRY) $(call MARKED,long)

lint: $(VENV)/.dev      ## ruff, mypy --strict, import rules
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

config-page: $(VENV)/.sim ## write config/README.md and config/scenarios/README.md anew from the code
	@$(BIN)/kollsman-sim list --keys > config/scenarios/README.md
	@printf '%s\n\n%s\n' '# Keys of companion.yaml' \
	  'You need no configuration file. Every key is optional; an unknown key, a wrong type or a value out of range is' > config/README.md
	@printf '%s\n\n' 'refused with one line. `kollsman check FILE` validates a file. Written by `make config-page`, not by hand.' >> config/README.md
	@$(BIN)/kollsman check --keys >> config/README.md

LOCK   := uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --no-annotate --no-emit-index-url
lock:            ## write the pinned versions and hashes of the images anew (docker/*.lock; needs uv)
	$(LOCK) --upgrade pyproject.toml -o docker/companion.lock
	$(LOCK) --upgrade --extra sim --no-emit-package jsbsim -c docker/companion.lock pyproject.toml -o docker/sim.lock
	echo 'jsbsim>=1.2.3' | $(LOCK) --upgrade --no-deps - -o docker/jsbsim.lock
	echo 'hatchling>=1.25' | $(LOCK) --upgrade - -o docker/build.lock

messages-page: $(VENV)/.sim ## write docs/messages.md anew from the code
	@$(BIN)/python -m companion.message_page > docs/messages.md

bench: $(VENV)/.dev     ## latency, load, memory, start-up, speed: measured, and written into the README
	$(BIN)/python -m tests.bench --write

clean:           ## remove the environment, caches and outputs
	rm -rf $(VENV) out build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis

$(VENV)/.made:
	@test -n "$(PYTHON)" || { echo "no Python found: install Python 3.11 or newer"; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "$(PYTHON) is too old: Python 3.11 or newer is needed (make PYTHON=/path/to/python3.11)"; exit 1; }
	@$(PYTHON) -m venv $(VENV) || { echo "the venv module is missing (Debian: apt install python3-venv)"; exit 1; }
	@touch $@

$(VENV)/.sim: $(VENV)/.made pyproject.toml
	@echo "installing Kollsman with the extra sim (JSBSim, matplotlib) into $(VENV) ..."
	@$(PIP) -e '.[sim]'
	@$(BYTES)
	@touch $@

$(VENV)/.dev: $(VENV)/.made pyproject.toml
	@echo "installing Kollsman with the extras sim and dev (test tools) into $(VENV) ..."
	@$(PIP) -e '.[sim,dev]'
	@$(BYTES)
	@touch $@ $(VENV)/.sim
