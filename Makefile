# Everything a fresh clone needs is Python 3.10 to 3.13 with venv, and make.
#
#   make demo    simulate a drive, calibrate it online and offline, compare with the truth
#   make test      every check: style, types, the demo, all tests on the newest dependencies,
#                  and those of the numbers on the oldest
#   make test-all  the same, and the tests that take minutes: long statistics, soak, 50 signals
#   make unit      only the tests on the newest
#   make lint      only style and types
#   make docs      the documentation site, in build/docs
#   make clean   remove what these made
#
# On a sourced ROS 2 Jazzy machine its own rclpy and NumPy are used; elsewhere rclpy comes from
# wheels.

SHELL := /bin/bash -o pipefail
.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: demo test test-all unit lint oldest beside docs clean

VENV := .venv
BIN := $(VENV)/bin
SETUP_FILES := setup.py setup.cfg pyproject.toml package.xml Makefile

export OMP_NUM_THREADS ?= 1
# Many processes import the same modules.
unexport PYTHONDONTWRITEBYTECODE
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PIP_ROOT_USER_ACTION := ignore
# Processes of the tests. Each begins with a part of its own, so that what the tests of a file
# share is made once, and takes from the others when it is done.
JOBS ?= $(shell nproc)
TOGETHER := -n $(JOBS) --dist worksteal
# Python compiles the modules that the tests use when they are imported; most never are.
PIP_OPTIONS := -m pip install --quiet --no-compile
PIP_INSTALL = $(BIN)/python $(PIP_OPTIONS) -c $(VENV)/constraints.txt

NO_RCLPY := echo 'error: where pip did not find rclpy: it has wheels only for Linux on x86-64;' \
	'elsewhere source a ROS 2 Jazzy installation first' >&2; exit 1

# The first interpreter that can make an environment and that rclpy has wheels for.
SUITABLE := import ensurepip, sys, venv; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))
PYTHON ?= $(firstword $(foreach python, python3 python3.12 python3.13 python3.11 python3.10, \
	$(shell $(python) -c '$(SUITABLE)' >/dev/null 2>&1 && echo $(python))))

# A sourced ROS was built against the NumPy of the system: nothing may shadow that one.
ifeq ($(ROS_DISTRO),jazzy)
SOURCED := $(shell python3 -c 'import rclpy' >/dev/null 2>&1 && echo yes)
endif
ifdef SOURCED
PYTHON := python3
endif
EXTRAS := test,lint,docs,colcon
ifndef SOURCED
EXTRAS := $(EXTRAS),ament,ros
endif

demo: $(VENV)/installed
	@$(BIN)/python demo/demo.py

test: beside oldest unit

test-all: beside oldest
	$(BIN)/python -m pytest $(TOGETHER) -m ''

unit: $(VENV)/installed-for-tests
	$(BIN)/python -m pytest $(TOGETHER)

# What keeps one core busy, and on another the second installation.
beside: $(VENV)/installed-for-tests
	@$(MAKE) --no-print-directory $(VENV)/oldest/installed & installing=$$!; \
	$(MAKE) --no-print-directory lint demo; status=$$?; wait $$installing && exit $$status

lint: $(VENV)/installed-for-tests
	$(BIN)/ruff check .
	$(BIN)/mypy

# The same tests on the oldest supported dependencies, without ROS: what needs it is skipped.
oldest: $(VENV)/oldest/installed
	$(VENV)/oldest/bin/python -m pytest $(TOGETHER) -q -r fE -m 'not slow and not statistical and not once'

docs: $(VENV)/installed-for-tests
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs build/docs

$(VENV)/constraints.txt:
	@test -n '$(PYTHON)' || { echo 'error: found no Python 3.10 to 3.13 with venv; install one' \
	    '(Debian, Ubuntu: apt install python3-venv) or name it: make PYTHON=...' >&2; exit 1; }
	@$(PYTHON) -m venv $(if $(SOURCED),--system-site-packages) $(VENV)
	@$(if $(SOURCED),$(BIN)/python -c 'import numpy; print("numpy==" + numpy.__version__)' >$@,touch $@)

$(VENV)/installed: $(VENV)/constraints.txt $(SETUP_FILES)
	@echo 'installing into $(VENV) ...'
	@$(PIP_INSTALL) -e .
	@$(if $(SOURCED),,$(PIP_INSTALL) -e '.[ros]' || { $(NO_RCLPY); })
	@touch $@

# In one go with what the demo needs: each call resolves and builds anew.
$(VENV)/installed-for-tests: $(VENV)/constraints.txt $(SETUP_FILES)
	@echo 'installing into $(VENV), with the tools of the tests ...'
	@$(PIP_INSTALL) -e '.[$(EXTRAS)]' || { $(NO_RCLPY); }
	@touch $(VENV)/installed $@

$(VENV)/oldest/installed: test/oldest.txt $(VENV)/installed-for-tests
	@$(PYTHON) -m venv $(VENV)/oldest
	@echo 'installing the oldest dependencies ...'
	@$(VENV)/oldest/bin/python $(PIP_OPTIONS) -c test/oldest.txt -e '.[test]'
	@touch $@

clean:
	rm -rf $(VENV) .demo build
