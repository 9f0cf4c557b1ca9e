# Everything lives in .venv: setup makes it, the other targets use it.
VENV := .venv
PYTHON ?= $(shell for p in python3 python3.12 python3.11; do \
	"$$p" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 12))' 2>/dev/null \
	&& command -v "$$p" && break; done)
STAMP := $(VENV)/.installed
DEMO_STAMP := $(VENV)/.demo_installed
PIP := $(VENV)/bin/python -m pip --disable-pip-version-check --quiet
UV := UV_SYSTEM_CERTS=1 VIRTUAL_ENV=$(VENV) $(VENV)/bin/uv --quiet pip
INSTALLED := setup.py setup.cfg package.xml pyproject.toml constraints.txt Makefile \
	$(wildcard scripts/* launch/*.launch.py params/*.yaml rviz/*)

# Another environment's ROS start-up hook must not pass for ours.
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE
# Some hundred processes import the sources: compiled once, not in each of them.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup test faults lint collect compile demo bench api coverage dist release clean

setup: $(STAMP)

# The demo's part of it is installed first, and alone: the tests' part takes as long again.
SCANS := ros,view
ALL := $(SCANS),drivers,batch,dev,doc

# uv downloads and unpacks side by side, in a quarter of pip's time; where it cannot, pip does the same.
# setuptools first and no build isolation: isolated builds would fetch an unpinned one.
define install
	@test -n "$(PYTHON)" || { echo 'error: needs Python 3.11 or 3.12 (none found; name one with PYTHON=...)' >&2; exit 1; }
	@echo 'installing into $(VENV), $(2) the first time'
	@test -x $(VENV)/bin/pip || $(PYTHON) -m venv $(VENV)
	@$(PIP) install -c constraints.txt setuptools uv
	@$(UV) install -c constraints.txt --no-build-isolation -e '.[$(1)]' || \
		$(PIP) install -c constraints.txt --no-build-isolation -e '.[$(1)]'
	@touch $@
endef

$(STAMP): $(INSTALLED)
	$(call install,$(ALL),about two minutes)

$(DEMO_STAMP): $(INSTALLED)
	$(call install,$(SCANS),about a minute)

lint: setup
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy

# Both once, not in each worker of the tests.
collect: lint
	@mkdir -p out; $(VENV)/bin/pytest --collect-only -q >out/collected.txt || { cat out/collected.txt; exit 1; }
compile: setup
	$(VENV)/bin/python -c 'from debris_scanner.warm_up import warm_up; warm_up()'

# What measures time runs alone, whole live scans two at a time: more would disturb each other.
# The rest runs side by side: a single node waits more than it computes.
SCANNED := ros and slow and not timing
# The files with tests of a mark: collecting all others takes as long as some tests.
files = $$(grep -lr 'mark\.$(1)' test --include='test_*.py')
# Threads of linear algebra in each of four workers wait for each other, busily.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1

# Recordings and scans that tests of several runs use are made in the first one.
test: export DEBRIS_SCANNER_ONCE := $(CURDIR)/out/once
test: setup
	rm -rf $(DEBRIS_SCANNER_ONCE)
	$(MAKE) --no-print-directory -j 2 collect compile
	$(ONE_THREAD) $(VENV)/bin/pytest -n 4 --dist loadscope --no-loadscope-reorder \
		-m 'not ($(SCANNED)) and not timing and not faults'
	$(VENV)/bin/pytest -n 2 --dist worksteal -m '$(SCANNED) and not faults' $(call files,slow)
	$(VENV)/bin/pytest -m 'timing and not faults' $(call files,timing)

# Kills nodes, fills disks, silences sensors: half an hour, before a release.
faults: setup compile
	$(VENV)/bin/pytest -m faults

demo: $(if $(wildcard $(STAMP)),setup,$(DEMO_STAMP))
	$(VENV)/bin/debris-scan demo

# Side by side with PCL (apt-get install libpcl-dev cmake g++) and small_gicp, where they can be had; some 15 minutes.
bench: setup
	-@$(PIP) install -c constraints.txt small_gicp
	$(VENV)/bin/python -m benchmarks.performance --write $(BENCH)

# The API's pages, in out/api; rosdoc2 makes the same from rosdoc2.yaml.
api: setup
	$(VENV)/bin/sphinx-build -q -j 2 -W --keep-going docs out/api

# Branches of the algorithms that the tests take, nodes and kernels left out: compiled code is not traced.
coverage: setup
	$(ONE_THREAD) $(VENV)/bin/pytest -n 2 -m 'not ros and not timing and not faults' --cov=debris_scanner --cov-branch \
		--cov-config=pyproject.toml --cov-report=term --cov-fail-under=85

# Sdist and wheel, the same bytes for the same commit, and their checksums.
dist: setup
	$(VENV)/bin/python -m tools.dist

# Every check before a release, an hour and a half; it publishes nothing. CHECKS='--only tree,version' runs a part.
release: setup
	$(VENV)/bin/python -m tools.release $(CHECKS)

clean:
	rm -rf $(VENV) build install log dist out/demo out/once *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +
