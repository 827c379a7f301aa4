# The commands that people and the CI run; `make help` lists them.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.ONESHELL:
.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory
export PATH := $(HOME)/.cargo/bin:$(PATH)

# Where `make run` keeps its database, blobs and logs, and the first port that it tries.
DATA ?= data
PORT ?= 8080
# Set to 1 to stop the service once the demo picture is there.
RUN_EXIT ?=

.PHONY: help
help: ## Lists the targets.
	@sed -n 's/^\([a-z-]*\):.*## /\1|/p' $(MAKEFILE_LIST) | column -t -s '|'

.PHONY: run
run: compiler ## Builds, starts service and worker, renders a demo scene and prints the address of its picture.
	@cargo build --release --locked --bin lightshaft
	lightshaft=$${CARGO_TARGET_DIR:-target}/release/lightshaft
	port=$(PORT)
	while (exec 3<>/dev/tcp/127.0.0.1/$$port) 2>/dev/null; do port=$$((port + 1)); done
	mkdir -p $(DATA)
	log=$(DATA)/serve.log
	"$$lightshaft" serve --listen "127.0.0.1:$$port" --data $(DATA) --insecure-local >$(DATA)/serve.out 2>"$$log" &
	service=$$!
	trap 'kill $$service 2>/dev/null; wait $$service 2>/dev/null || true' EXIT
	trap 'exit 0' INT TERM
	failed() { echo "make run: $$1; the end of $$log:" >&2; tail -n 20 "$$log" >&2; exit 1; }
	for _ in {1..300}; do
	  grep -q '^listening on ' $(DATA)/serve.out && break
	  kill -0 $$service 2>/dev/null || failed 'the service stopped'
	  sleep 0.1
	done
	server=$$(sed -n 's/^listening on //p' $(DATA)/serve.out)
	[ -n "$$server" ] || failed 'the service did not start within 30 s'
	export LIGHTSHAFT_SERVER=$$server
	"$$lightshaft" scene generate demo -o $(DATA)/demo.glb
	id() { sed -n 's/^[{ ]*"id": *"\([^"]*\)".*/\1/p' | head -n 1; }
	scene=$$("$$lightshaft" --json scene upload $(DATA)/demo.glb | id)
	job=$$("$$lightshaft" --json job submit "$$scene" --width 800 --height 450 --spp 32 | id)
	"$$lightshaft" job watch "$$job" || failed "job $$job failed"
	echo
	echo "The picture is on  $$server/jobs/$$job"
	if [ -z '$(RUN_EXIT)' ]; then
	  echo "The service goes on; Ctrl-C stops it. Its log: $$log"
	  wait $$service
	fi

.PHONY: test
test: test-tools lint ## Installs what tests need and runs everything: format, lints, all tests.
	@mkdir -p target
	echo '== tests'
	status=0
	cargo test --workspace --locked --no-fail-fast 2>&1 | tee target/test.log || status=$$?
	$(MAKE) test-python 2>&1 | tee target/test-python.log || status=$$?
	$(MAKE) test-browser 2>&1 | tee target/test-browser.log || status=$$?
	echo
	echo '== summary'
	grep -E '^test .* FAILED$$' target/test.log || true
	grep -E '^(FAILED|ERROR) ' target/test-python.log || true
	grep -E '^not ok ' target/test-browser.log || true
	awk '/^test result:/ { binaries++; passed += $$4; failed += $$6; ignored += $$8 }
	  /^=+ .* in [0-9.]+s/ { for (i = 1; i < NF; i++) {
	    if ($$(i + 1) ~ /^passed/) { passed += $$i; python = $$i }
	    if ($$(i + 1) ~ /^(failed|error)/) failed += $$i
	    if ($$(i + 1) ~ /^(skipped|xfailed|deselected)/) ignored += $$i } }
	  /^# pass / { passed += $$3; browser = $$3 }
	  /^# (fail|cancelled) / { failed += $$3 }
	  /^# (skipped|todo) / { ignored += $$3 }
	  END { printf "test result: %s. %d passed; %d failed; %d ignored; in %d test binaries, %d tests in Python and %d with Playwright\n",
	    failed || '$$status' ? "FAILED" : "ok", passed, failed, ignored, binaries, python, browser }' \
	  target/test.log target/test-python.log target/test-browser.log
	exit $$status

# Pinned packages, in a virtual environment that is made anew when their list changes.
PYTHON := target/python

.PHONY: test-python
test-python: compiler test-tools ## The Python client: lints, types, and its tests against the real service.
	@cargo build --locked --bin lightshaft
	echo '== python'
	cd api/python
	tools=$(CURDIR)/$(PYTHON)/bin
	python=". ../../worker/compare/tests"
	"$$tools/ruff" check --config pyproject.toml $$python
	"$$tools/ruff" format --check --config pyproject.toml $$python
	"$$tools/mypy"
	"$$tools/python" -m pytest

$(PYTHON)/ready: api/python/requirements-dev.lock api/python/pyproject.toml
	@rm -rf $(PYTHON)
	python3 -m venv $(PYTHON)
	$(PYTHON)/bin/pip install --quiet --disable-pip-version-check --require-hashes -r api/python/requirements-dev.lock
	$(PYTHON)/bin/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable api/python
	touch $@

# Packages of the lock file, which has their hashes; none of their scripts runs.
PLAYWRIGHT := tests/browser/node_modules/.package-lock.json

.PHONY: test-browser
test-browser: compiler test-tools ## The pages in Chromium with Playwright and axe-core; screenshots go to target/browser.
	@cargo build --locked --bin lightshaft
	echo '== browser'
	rm -rf "$${CARGO_TARGET_DIR:-target}/browser"
	node --test --test-reporter=tap tests/browser/*.test.js

$(PLAYWRIGHT): tests/browser/package-lock.json
	@npm ci --prefix tests/browser --ignore-scripts --no-audit --no-fund --loglevel=error
	touch $@

.PHONY: lint
lint: compiler ## Format, lints with warnings denied, and (where cargo-deny is installed) security advisories.
	@echo '== cargo fmt'
	cargo fmt --all --check
	echo '== cargo clippy'
	cargo clippy --workspace --all-targets --locked -- -D warnings
	if cargo deny --version >/dev/null 2>&1; then
	  echo '== cargo deny'
	  cargo deny check
	else
	  echo 'cargo-deny is not installed: advisories are not checked (licences and sources are, by tests/tests/licences.rs)'
	fi

.PHONY: bench
bench: compiler ## Benchmarks of the engine.
	@cargo bench --locked -p lightshaft-engine

# A linker for Rust, and a C compiler for SQLite.
.PHONY: compiler
compiler:
	@command -v cargo >/dev/null || { echo 'no cargo: install Rust from https://rustup.rs' >&2; exit 1; }
	command -v cc >/dev/null || $(MAKE) apt PACKAGES='build-essential'

# What tests use beside Rust: a software Vulkan driver (lavapipe), a browser with its WebDriver, Python and Node with packages.
.PHONY: test-tools
test-tools:
	@missing=
	ldconfig -p | grep -q libvulkan.so.1 || missing+=' libvulkan1'
	compgen -G '/usr/share/vulkan/icd.d/lvp_icd*.json' >/dev/null || missing+=' mesa-vulkan-drivers'
	command -v chromium >/dev/null || missing+=' chromium'
	command -v chromedriver >/dev/null || missing+=' chromium-driver'
	python3 -c 'import ensurepip, venv' 2>/dev/null || missing+=' python3-venv'
	command -v node >/dev/null || missing+=' nodejs'
	command -v npm >/dev/null || missing+=' npm'
	[ -z "$$missing" ] || $(MAKE) apt PACKAGES="$$missing"
	$(MAKE) $(PYTHON)/ready $(PLAYWRIGHT)

# Installs Debian packages as root or with sudo. On Debian 12, Mesa comes from backports: the lavapipe of its release
# (22.3) works too, and is slower.
.PHONY: apt
apt:
	@if [ "$$(id -u)" = 0 ]; then sudo=
	elif sudo -n true 2>/dev/null; then sudo='sudo'
	else echo "please install as root: apt-get install $(PACKAGES)" >&2; exit 1; fi
	command -v apt-get >/dev/null || { echo "please install the equal of these Debian packages: $(PACKAGES)" >&2; exit 1; }
	. /etc/os-release
	release=
	if [ "$${VERSION_CODENAME:-}" = bookworm ]; then
	  release='-t bookworm-backports'
	  if ! apt-cache policy | grep -q 'n=bookworm-backports'; then
	    echo 'deb http://deb.debian.org/debian bookworm-backports main' |
	      $$sudo tee /etc/apt/sources.list.d/bookworm-backports.list >/dev/null
	  fi
	fi
	$$sudo apt-get update
	for package in $(PACKAGES); do
	  case $$package in
	    mesa-*) $$sudo env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends $$release $$package ;;
	    *) $$sudo env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends $$package ;;
	  esac
	done
