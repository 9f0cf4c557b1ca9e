# Everything lives in .venv: setup makes it, the other targets use it.
VENV := .venv
PYTHON ?= $(shell for p in python3 python3.12 python3.11; do \
	"$$p" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 12))' 2>/dev/null \
	&& command -v "$$p" && break; done)
STAMP := $(VENV)/.installed
PIP := $(VENV)/bin/python -m pip --disable-pip-version-check --quiet
INSTALLED := setup.py setup.cfg package.xml pyproject.toml constraints.txt Makefile \
	$(wildcard scripts/* launch/*.launch.py params/*.yaml rviz/*)

# Another environment's ROS start-up hook must not pass for ours.
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE
# Some hundred processes import the sources: compiled once, not in each of them.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup test faults lint compile demo bench api coverage clean

setup: $(STAMP)

$(STAMP): $(INSTALLED)
	@test -n "$(PYTHON)" || { echo 'error: needs Python 3.11 or 3.12 (none found; name one with PYTHON=...)' >&2; exit 1; }
	@echo 'installing into $(VENV), about two minutes the first time'
	@$(PYTHON) -m venv $(VENV)
	@# setuptools first and no build isolation: isolated builds would fetch an unpinned one.
	@$(PIP) install -c constraints.txt setuptools
	@$(PIP) install -c constraints.txt --no-build-isolation -e '.[ros,drivers,view,batch,dev,doc]'
	@touch $@

lint: setup
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy

# Once, not in each worker of the tests.
compile: setup
	$(VENV)/bin/python -c 'from debris_scanner.warm_up import warm_up; warm_up()'

# Whole live scans, and what measures time, run alone: they would disturb each other.
# The rest runs side by side: a single node waits more than it computes.
ALONE := ((ros and slow) or timing)
# Threads of linear algebra in each of four workers wait for each other, busily.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1

# Recordings and scans that tests of both runs use are made in the first one.
test: export DEBRIS_SCANNER_ONCE := $(CURDIR)/out/once
test: setup
	rm -rf $(DEBRIS_SCANNER_ONCE)
	$(MAKE) --no-print-directory -j 2 lint compile
	$(ONE_THREAD) $(VENV)/bin/pytest -n 4 --dist loadscope --no-loadscope-reorder -m 'not $(ALONE) and not faults'
	$(VENV)/bin/pytest -m '$(ALONE) and not faults' \
		$$(grep -lE 'mark\.(slow|timing)' $$(grep -lrE 'mark\.(ros|timing)' test --include='test_*.py'))

# Kills nodes, fills disks, silences sensors: half an hour, before a release.
faults: setup
	$(VENV)/bin/pytest -m faults

demo: setup
	$(VENV)/bin/debris-scan live --simulate shuttle_stack --out out/demo

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

clean:
	rm -rf $(VENV) build install log dist out/demo out/once *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +
