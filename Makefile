# Every target works as the first command in a fresh clone: what it needs is made
# first, in .venv, from constraints.txt. `make demo ARGS="--cycle-ms 4"` passes options.

PYTHON ?= python3
ARGS ?=
PYTEST ?= .venv/bin/python -m pytest
PREFIX ?= /opt/linemate
OWN := $(if $(filter /opt/% /usr /usr/%,$(PREFIX)),,$(PREFIX))
ETC ?= $(OWN)/etc/linemate
UNITS ?= $(OWN)/etc/systemd/system
SYSUSERS ?= $(OWN)/etc/sysusers.d
TMPFILES ?= $(OWN)/etc/tmpfiles.d
BIN ?= $(if $(OWN),$(OWN)/bin,/usr/local/bin)
SHARE ?= $(if $(OWN),$(OWN)/share,/usr/local/share)
SERVICES := linemated.service linemated@.service linemate-metrics.service linemate-bridge.service

.PHONY: help demo test lint format bench dst fuzz coverage judged mutants mutation floods accuracy world install install-program install-files \
	uninstall systemd-test docs docs-write results sbom clean

help:
	@echo "make demo     the wheel assembly in real time, ARGS=... for options; leaves out/demo"
	@echo "make test     every test; ARGS=... goes to pytest"
	@echo "make lint     ruff, mypy, import contracts, vocabulary"
	@echo "make format   ruff's formatting and safe fixes"
	@echo "make bench    what a step costs on this machine"
	@echo "make dst      seeded fault runs in virtual time, SEEDS=FIRST:LAST; ARGS=... for options"
	@echo "make fuzz     every parser with a million damaged messages; ARGS=--inputs=N"
	@echo "make coverage every branch of states, watch, gate, exchange and parsers by their own tests"
	@echo "make mutants  changes of states, watch, gate, exchange and parsers that no test notices"
	@echo "make floods   20 000 datagrams a second on each port, judged by a robot that goes on"
	@echo "make accuracy the tables of docs/results/accuracy.md, in hours; ARGS=--short for a few runs"
	@echo "make world    the rows of the realistic world; ARGS=\"--rows 'conveyor*' --seeds 0..2\""
	@echo "make docs     links, generated pages, and every command that the pages show"
	@echo "make results  measure the figures of the pages again, NAME=campaign or another"
	@echo "make sbom     bill of materials (CycloneDX) of what make install installs"
	@echo "make systemd-test  the service under a real systemd, in namespaces; as root"
	@echo "make install  into PREFIX=$(PREFIX), with units, manuals and a first configuration"

demo: .venv/.ok
	.venv/bin/linemate-sim demo --out out/demo $(ARGS)

test: .venv/.ok
	$(PYTEST) $(ARGS)

lint: .venv/.ok
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy
	.venv/bin/lint-imports
	.venv/bin/python docs/make/vocabulary.py

format: .venv/.ok
	.venv/bin/ruff check --fix .
	.venv/bin/ruff format .

bench: .venv/.ok
	.venv/bin/linemate-sim bench $(ARGS)

dst: .venv/.ok
	@.venv/bin/python -m linemate.simulators.lab.faults.dst $(SEEDS) $(ARGS)

fuzz: .venv/.ok
	.venv/bin/python tests/fuzz.py $(ARGS)

# Every branch of the state machine, the gate, the exchange and the parsers, by their own tests.
OWN_TESTS := tests/protocol tests/cycle/test_states_cases.py tests/cycle/test_watch.py \
	tests/core/control/test_command_limiter.py tests/core/control/test_command_limiter_transcript.py
JUDGED := daemon/cycle/states.py,daemon/cycle/watch.py,daemon/core/control/axis_limits.py,protocol/exchange*.py
JUDGED := $(JUDGED),daemon/core/control/command_limiter.py,protocol/rsi/*.py,protocol/command/*.py,protocol/sensors/*.py,protocol/units.py
JUDGED := $(JUDGED),protocol/controller_*.py,protocol/egm/*.py,protocol/fanuc/*.py

coverage: .venv/.ok
	COVERAGE_FILE=.coverage.judged .venv/bin/python -m coverage run -m pytest -q $(OWN_TESTS) $(ARGS)
	@COVERAGE_FILE=.coverage.judged $(MAKE) --no-print-directory judged

# The same of the last measured run, whatever tests it had.
judged:
	.venv/bin/python -m coverage report -m --include="$(JUDGED)" --skip-covered --fail-under=100

mutants mutation: .venv/.ok
	.venv/bin/python tests/mutants.py $(ARGS)

floods: .venv/.ok
	.venv/bin/python tests/floods.py $(ARGS)

accuracy: .venv/.ok
	.venv/bin/python -m linemate.simulators.lab.accuracy $(ARGS)

world: .venv/.ok
	.venv/bin/linemate-sim world $(ARGS)

# Debian's python3 has no ensurepip and its pip refuses the system's site-packages:
# an environment without pip, filled by a pip from outside, needs neither.
define environment
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
		echo "linemate needs Python 3.11 or later; $(PYTHON) is $$($(PYTHON) --version 2>&1)." \
		     "Another one: make PYTHON=python3.12 $(MAKECMDGOALS)" >&2; exit 1; }
	$(PYTHON) -m venv --without-pip $(1)
	@set -e; what="-c constraints.txt $(2)"; \
	if $(PYTHON) -m pip --version >/dev/null 2>&1; then \
		set -x; $(PYTHON) -m pip --python $(1)/bin/python install -q $(3) $$what; \
	elif command -v uv >/dev/null; then \
		set -x; uv pip install -q --python $(1)/bin/python $$what; \
	elif $(1)/bin/python -m ensurepip >/dev/null 2>&1; then \
		set -x; $(1)/bin/python -m pip install -q $(3) $$what; \
	else \
		echo "no way to install packages; on Debian: apt install python3-pip libgomp1 make" >&2; \
		exit 1; \
	fi
	@$(1)/bin/python -c 'import pinocchio' || { \
		echo "pinocchio does not load; its usual missing library is libgomp:" \
		     "apt install libgomp1, then make again" >&2; exit 1; }
endef

.venv/.ok: pyproject.toml constraints.txt
	$(call environment,.venv,-e .[dev],--no-compile)
	@# Not by pip, which has one process for it. Some packages hold files of other Pythons: they fail.
	@.venv/bin/python -m compileall -qq -j 0 .venv/lib protocol drivers daemon simulators || true
	@# A disk that still takes in this gigabyte stalls a virtual machine for 0.1 s: a demo would fail.
	@sync
	@touch $@

# The program into $(PREFIX), the rest as install-files. As root for a PREFIX of the system; any other
# keeps everything below itself. A configuration that is there already is left as it is.
install: install-program install-files

install-program:
	rm -rf build
	$(call environment,$(PREFIX),--no-deps -r requirements.txt .)
	rm -rf build
	@case "$$(readlink -f $(PREFIX)/bin/python)" in /home/*|/root/*) \
		echo "note: the unit's sandbox does not see $$(readlink -f $(PREFIX)/bin/python);" \
		     "for the service: make install PYTHON=/usr/bin/python3" >&2;; esac

SED = sed 's|/opt/linemate|$(PREFIX)|g; s|/etc/linemate|$(ETC)|g'

install-files:
	install -d $(DESTDIR)$(UNITS) $(DESTDIR)$(ETC) $(DESTDIR)$(BIN) $(DESTDIR)$(SYSUSERS) \
		$(DESTDIR)$(TMPFILES) $(DESTDIR)$(SHARE)/man/man1 $(DESTDIR)$(SHARE)/man/man5 \
		$(DESTDIR)$(SHARE)/man/man8 $(DESTDIR)$(SHARE)/bash-completion/completions \
		$(DESTDIR)$(SHARE)/zsh/site-functions $(DESTDIR)$(SHARE)/linemate
	for unit in $(SERVICES); do $(SED) systemd/$$unit > $(DESTDIR)$(UNITS)/$$unit; done
	install -m 644 systemd/sysusers.conf $(DESTDIR)$(SYSUSERS)/linemate.conf
	install -m 644 systemd/tmpfiles.conf $(DESTDIR)$(TMPFILES)/linemate.conf
	for page in docs/man/*.[158]; do \
		install -m 644 $$page $(DESTDIR)$(SHARE)/man/man$${page##*.}/; done
	for program in linemate linemated linemate-sim; do \
		install -m 644 docs/completion/$$program.bash \
			$(DESTDIR)$(SHARE)/bash-completion/completions/$$program; \
		install -m 644 docs/completion/_$$program $(DESTDIR)$(SHARE)/zsh/site-functions/; done
	install -m 644 daemon/data/linemated.schema.json docs/sbom.cdx.json $(DESTDIR)$(SHARE)/linemate/
	test -e $(DESTDIR)$(ETC)/linemated.yaml || sed \
		's|/run/linemate|$(OWN)&|; s|/var/li[b]/linemate|$(OWN)&|; s|/var/log/linemate|$(OWN)&|' \
		systemd/linemated.yaml > $(DESTDIR)$(ETC)/linemated.yaml
	test -z "$(OWN)" || install -d $(addprefix $(OWN),/run/linemate /var/lib/linemate /var/log/linemate)
	test $(BIN) = $(PREFIX)/bin || for program in linemate linemated linemate-sim; do \
		ln -sf $(PREFIX)/bin/$$program $(DESTDIR)$(BIN)/; done
	@if [ -z "$(DESTDIR)$(OWN)" ] && [ "$$(id -u)" = 0 ]; then \
		for made in "systemd-sysusers $(SYSUSERS)" "systemd-tmpfiles --create $(TMPFILES)"; do \
			if command -v $${made%% *} >/dev/null; then $$made/linemate.conf; fi; done; fi
	@echo "next: edit $(ETC)/linemated.yaml, try it: $(BIN)/linemated --check --config" \
	      "$(ETC)/linemated.yaml, then: systemctl daemon-reload && systemctl enable --now linemated"

uninstall:
	rm -rf $(PREFIX)/bin $(PREFIX)/lib $(PREFIX)/lib64 $(PREFIX)/include $(PREFIX)/pyvenv.cfg
	rm -f $(addprefix $(UNITS)/,$(SERVICES)) $(SYSUSERS)/linemate.conf $(TMPFILES)/linemate.conf \
		$(addprefix $(BIN)/,linemate linemated linemate-sim) $(SHARE)/man/man?/linemate*.[158] \
		$(addprefix $(SHARE)/bash-completion/completions/,linemate linemated linemate-sim) \
		$(addprefix $(SHARE)/zsh/site-functions/_,linemate linemated linemate-sim)
	@echo "left: $(ETC), and what the daemon wrote"

# The service under a real systemd, in namespaces that are thrown away; as root.
systemd-test: .venv/.ok
	$(PYTEST) tests/systemd $(ARGS)

# Links, pages and manuals in step with the code, and every command that the pages show.
docs: .venv/.ok
	$(PYTEST) tests/docs $(ARGS)

# Write the generated pages, manuals, completions and the bill of materials.
docs-write: .venv/.ok
	.venv/bin/python -m docs.make.write

# Measure one result of docs/results again; the tree must have no changes.
results: .venv/.ok
	.venv/bin/python -m docs.make.results $(NAME)

# docs/sbom.cdx.json and requirements.txt: what `make install` installs.
sbom: .venv/.ok
	.venv/bin/python -m docs.make.write sbom.cdx.json requirements.txt

clean:
	rm -rf out build .coverage* .mypy_cache .pytest_cache .ruff_cache .hypothesis
