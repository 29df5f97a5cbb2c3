# Two commands do everything: `make demo` and `make test`. Both install into .venv first.
VENV := .venv
PY := $(VENV)/bin/python
STAMP := $(VENV)/.installed
KERNELS := $(VENV)/.compiled
TEST_STAMP := $(VENV)/.installed-test
LIBPYTHON := libpython$(shell python3 -c 'import sys; print("%d.%d" % sys.version_info[:2])')
APT := chromium fonts-dejavu-core libegl1 libopengl0 $(LIBPYTHON) libusb-1.0-0 systemd tmux \
	gcc libc6-dev gcc-avr avr-libc libsimavr-dev libelf-dev
ifneq ($(shell id -u),0)
SUDO := sudo
endif

.PHONY: demo test lint install install-test system-packages bench faults soak clean

demo: $(KERNELS)
	@$(VENV)/bin/sweepscope demo

install: $(STAMP)

install-test: $(TEST_STAMP)

$(VENV)/bin/python:
	python3 -m venv $(VENV)

$(STAMP): pyproject.toml constraints.txt | $(VENV)/bin/python
	$(PY) -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable .
	@touch $@

$(TEST_STAMP): pyproject.toml constraints.txt | $(VENV)/bin/python
	$(PY) -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[test]'
	@touch $@ $(STAMP)

# the fold and its estimates are compiled once; whoever starts first afterwards need not wait
$(KERNELS): $(STAMP) $(wildcard process/*.py process/fold/*.py process/crossings/*.py process/edge_fit/*.py process/cloud/*.py)
	@echo "compiling the fold, once: about a minute"
	@$(PY) -m process.warmup
	@touch $@

# what the tests need beside Python: a browser, libraries of Open3D (EGL, USB), PyMeshLab (OpenGL) and GenICam (Python),
# systemd, a terminal multiplexer, the AVR compiler and its emulator; tests/needs.py has a check for each
system-packages:
	@missing=""; for p in $(APT); do dpkg -s $$p >/dev/null 2>&1 || missing="$$missing $$p"; done; \
	if [ -n "$$missing" ]; then \
		echo "installing$$missing"; \
		$(SUDO) apt-get update -qq && DEBIAN_FRONTEND=noninteractive $(SUDO) apt-get install -y -qq --no-install-recommends $$missing >/dev/null; \
	fi

lint: $(TEST_STAMP)
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports

# two at a time: most system tests wait for processes and deadlines; a file's tests stay together and in order
test: system-packages $(TEST_STAMP) lint $(KERNELS)
	$(PY) -m pytest -n 2 --dist loadfile

# make bench BENCH=console, or BENCH="estimates --speed"; without it fold and pipeline
BENCH ?=
bench: $(TEST_STAMP) $(KERNELS)
ifeq ($(BENCH),)
	$(PY) -m tests.bench fold
	$(PY) -m tests.bench pipeline
else
	$(PY) -m tests.bench $(BENCH)
endif

# the fault table over many points; SABOTAGE=1 switches each protection off in turn, WRITE=docs/faults.md keeps the table
POINTS ?= 3
SEEDS ?= 1
KILLS ?= 200
CONTROLLER ?= simulated
MODE ?= step
BOMBS ?= 100000
faults: $(TEST_STAMP)
	$(PY) -m tests.faults --mode $(MODE) --points $(POINTS) --seeds $(SEEDS) --kills $(KILLS) --controller $(CONTROLLER) --bombs $(BOMBS) \
		$(if $(SABOTAGE),--sabotage) $(if $(ROWS),--rows $(ROWS)) $(if $(WRITE),--write $(WRITE))

MINUTES ?= 60
soak: $(TEST_STAMP)
	$(PY) -m tests.faults.soak --minutes $(MINUTES)

clean:
	rm -rf $(VENV) demo-data build dist .pytest_cache .mypy_cache .ruff_cache
