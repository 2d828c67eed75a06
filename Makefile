# Two commands: `make run` (the whole chain, quick profile) and `make test`. Each sets up .venv by itself when it is
# missing or requirements.lock has changed.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
PROFILE ?= quick
PORT ?= 5000
# Where the flows' steps run: nothing (two at a time, here), local (a Dask cluster of two workers, here), tcp://HOST:8786.
CLUSTER ?= $(DIESELTWIN_CLUSTER)
# Where MLflow and Prefect keep their rows: nothing (sqlite in mlruns/ and .prefect/) or postgresql://USER:PASSWORD@HOST/DATABASE.
MLFLOW ?= $(DIESELTWIN_MLFLOW)
PREFECT ?= $(DIESELTWIN_PREFECT)
RECORDINGS ?=
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/installed.lock

# One thread in each process: two spinning pools on two shared cores are 10-70 times slower, and results repeat bit by bit.
export OMP_NUM_THREADS := 1
export MKL_NUM_THREADS := 1
# Everything that tools keep stays in the project, and none of them calls home.
export PREFECT_HOME := $(CURDIR)/.prefect
export PREFECT_SERVER_ANALYTICS_ENABLED := false
export PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS := 180
export MLFLOW_DISABLE_TELEMETRY := true
export MLFLOW_SERVER_ENABLE_JOB_EXECUTION := false
export DVC_NO_ANALYTICS := true
export DO_NOT_TRACK := true
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PIP_ROOT_USER_ACTION := ignore
export PYTHONUNBUFFERED := 1
export DIESELTWIN_CLUSTER := $(CLUSTER)
export DIESELTWIN_MLFLOW := $(MLFLOW)
export DIESELTWIN_PREFECT := $(PREFECT)

.DEFAULT_GOAL := help
.PHONY: help setup run repro discover proof evaluate bench promote test test-all check docs ui champion serve

help:  ## this list
	@echo "make run    the whole chain: data, pretraining, identification, report (PROFILE=quick or paper)"
	@echo "make repro  the same through DVC: checks every file against dvc.lock"
	@echo "make discover  what physics the twin left out (RECORDINGS='a.csv b.parquet'; none: a concealed machine)"
	@echo "make proof  the concealed benchmark: 40 machines, at most 15 minutes (PROFILE=paper: 300)"
	@echo "make evaluate  the paper's tables and figures, from ensembles of every method (PROFILE=quick or paper)"
	@echo "make bench  every speed, part by part, into docs/speed.md; goes on where it was stopped (PROFILE=paper: an hour)"
	@echo "make promote  put newly trained networks into MLflow's registry, in use if physics holds and they aren't worse"
	@echo "make test   the tests: every part, every command, every kind of machine"
	@echo "make test-all  the same, the evaluation and some eighty more whole judgements (twice as long)"
	@echo "make check  style, types, import directions, hygiene"
	@echo "make docs   the documentation as a site, in site/"
	@echo "make ui     MLflow with the results (PORT=5000)"
	@echo "make champion  the networks in use as a service: inputs of a recording in, states out (PORT=5001)"
	@echo "make serve  retraining on a schedule"

setup: $(READY)  ## .venv with the exact versions of requirements.lock

# The stamp is a copy of the lock, written last: an interrupted set-up is done again. What is installed is compiled on
# all cores, where pip takes one; a package's templates that aren't Python are no error.
$(READY): requirements.lock pyproject.toml
	@if ! { cmp -s $@ requirements.lock && $(BIN)/python -c "" 2>/dev/null; }; then \
		rm -f $@; \
		$(PYTHON) -c "import sys; sys.exit(not (3, 11, 5) <= sys.version_info < (3, 12))" 2>/dev/null || { \
			echo "Python 3.11 from 3.11.5 on is needed, got $$($(PYTHON) --version 2>&1 | head -1): make PYTHON=/path/to/python3.11" >&2; \
			exit 1; \
		}; \
		echo "Setting up $(VENV) from requirements.lock (some 2 minutes, once) ..."; \
		$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV) || exit 1; \
		$(BIN)/python tasks/install.py requirements.lock || exit 1; \
		$(BIN)/python -m compileall -qq -j 0 -x '/tests?/' $(VENV)/lib || true; \
	fi
	@$(BIN)/python -m pip install -qq --no-deps --no-build-isolation -e .
	@$(BIN)/python -m compileall -q dieseltwin flows tasks  # as pip does: some machines forbid Python to keep it later
	@cp requirements.lock $@

run: $(READY)  ## data, pretraining, the three identifications, report
	@$(BIN)/python -m flows.run --profile $(PROFILE)

repro: $(READY)  ## the same flows as stages of dvc.yaml; what dvc.lock knows is not run again
	@$(BIN)/dvc repro

discover: $(READY)  ## what physics the twin left out of recordings
	@$(BIN)/python -m flows.discover --profile $(PROFILE) $(RECORDINGS)

proof: $(READY)  ## the concealed benchmark of the profile; goes on where it was stopped
	@$(BIN)/python -m flows.prove --profile $(PROFILE)

evaluate: $(READY)  ## the paper's tables and figures
	@$(BIN)/python -m flows.evaluate --profile $(PROFILE)

bench: $(READY)  ## docs/speed.md
	@$(BIN)/python benchmarks/bench.py $(if $(filter paper,$(PROFILE)),--full)

promote: $(READY)  ## the registry's champion, from models/
	@$(BIN)/python -m flows.promote --profile $(PROFILE)

# Where a machine forbids Python to keep what it compiled, every process would compile all test modules anew, and every
# step and command of the tests its part of the library.
test test-all: export PYTHONDONTWRITEBYTECODE :=
test: $(READY)  ## all tests but the thorough ones, on two processes
	@$(BIN)/python -m pytest -n 2 --no-loadscope-reorder -q -m "not thorough"

test-all: $(READY)  ## all tests on two processes
	@$(BIN)/python -m pytest -n 2 --no-loadscope-reorder -q

check: $(READY)  ## style, types, directions, hygiene
	@$(BIN)/python -m ruff check --quiet --output-format concise .
	@$(BIN)/python -m mypy --no-error-summary
	@$(BIN)/python -c "import sys; from importlinter.cli import lint_imports_command as lint; sys.exit(lint())" --no-logo
	@$(BIN)/python .ci/hygiene.py
	@echo "check: all good"

docs: $(READY)  ## the documentation's site; a broken link ends the build
	@NO_MKDOCS_2_WARNING=true $(BIN)/python -m mkdocs build --strict --quiet
	@echo "site/index.html"

ui: $(READY)  ## MLflow with the comparison of the methods
	@$(BIN)/python -m tasks.ui --port $(PORT)

champion: PORT := $(if $(filter 5000,$(PORT)),5001,$(PORT))
champion: $(READY)  ## mlflow models serve of the registry's champion
	@$(BIN)/python -m tasks.serve_champion --port $(PORT)

serve: $(READY)  ## retraining deployment with its schedule
	@$(BIN)/python -m flows.retrain --serve
