# Every target works as the first command in a fresh clone: what it needs is made
# first, in .venv, from constraints.txt. `make demo ARGS="--cycle-ms 4"` passes options.

PYTHON ?= python3
ARGS ?=
PYTEST ?= .venv/bin/python -m pytest
PREFIX ?= /opt/linemate
ETC ?= /etc/linemate
UNITS ?= /etc/systemd/system
BIN ?= /usr/local/bin

.PHONY: help demo test lint format bench accuracy install clean

help:
	@echo "make demo     the wheel assembly in real time, ARGS=... for options; leaves out/demo"
	@echo "make test     every test; ARGS=... goes to pytest"
	@echo "make lint     ruff, mypy, import walls"
	@echo "make format   ruff's formatting and safe fixes"
	@echo "make bench    what a step costs on this machine"
	@echo "make dst      seeded fault runs in virtual time, SEEDS=FIRST:LAST; ARGS=... for options"
	@echo "make accuracy the tables of docs/accuracy.md, in hours; ARGS=--short for a few runs"
	@echo "make install  into PREFIX=$(PREFIX), with units and a first configuration"

demo: .venv/.ok
	.venv/bin/linemate-sim demo --out out/demo $(ARGS)

test: .venv/.ok
	$(PYTEST) $(ARGS)

lint: .venv/.ok
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	@set -e; for room in protocol drivers daemon simulators; do \
		echo "mypy -p linemate.$$room"; .venv/bin/mypy -p linemate.$$room; done
	.venv/bin/lint-imports

format: .venv/.ok
	.venv/bin/ruff check --fix .
	.venv/bin/ruff format .

bench: .venv/.ok
	.venv/bin/linemate-sim bench $(ARGS)

dst: .venv/.ok
	@.venv/bin/python -m linemate.simulators.harness.dst $(SEEDS) $(ARGS)

accuracy: .venv/.ok
	.venv/bin/python -m linemate.simulators.harness.accuracy $(ARGS)

# Debian's python3 has no ensurepip and its pip refuses the system's site-packages:
# an environment without pip, filled by a pip from outside, needs neither.
define environment
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
		echo "linemate needs Python 3.11 or later; $(PYTHON) is $$($(PYTHON) --version 2>&1)." \
		     "Another one: make PYTHON=python3.12 $(MAKECMDGOALS)" >&2; exit 1; }
	$(PYTHON) -m venv --without-pip $(1)
	@set -e; what="-c constraints.txt $(2)"; \
	if $(PYTHON) -m pip --version >/dev/null 2>&1; then \
		set -x; $(PYTHON) -m pip --python $(1)/bin/python install -q $$what; \
	elif command -v uv >/dev/null; then \
		set -x; uv pip install -q --python $(1)/bin/python $$what; \
	elif $(1)/bin/python -m ensurepip >/dev/null 2>&1; then \
		set -x; $(1)/bin/python -m pip install -q $$what; \
	else \
		echo "no way to install packages; on Debian: apt install python3-pip libgomp1 make" >&2; \
		exit 1; \
	fi
	@$(1)/bin/python -c 'import pinocchio' || { \
		echo "pinocchio does not load; its usual missing library is libgomp:" \
		     "apt install libgomp1, then make again" >&2; exit 1; }
endef

.venv/.ok: pyproject.toml constraints.txt
	$(call environment,.venv,-e .[dev])
	@touch $@

# As root. A configuration that is there already is left as it is.
install:
	$(call environment,$(PREFIX),.)
	install -d $(UNITS) $(ETC) $(BIN)
	sed 's|/opt/linemate|$(PREFIX)|g; s|/etc/linemate|$(ETC)|g' systemd/linemated.service \
		> $(UNITS)/linemated.service
	test -e $(ETC)/linemated.yaml || install -m 644 systemd/linemated.yaml $(ETC)/
	ln -sf $(PREFIX)/bin/linemated $(PREFIX)/bin/linemate $(PREFIX)/bin/linemate-sim $(BIN)/
	@echo "next: edit $(ETC)/linemated.yaml, then" \
	      "systemctl daemon-reload && systemctl enable --now linemated"

clean:
	rm -rf out build .coverage .mypy_cache .pytest_cache .ruff_cache .hypothesis
