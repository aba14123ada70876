# Needs Python 3.11 or newer and make; everything else is installed into .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
ROOMS := behavioural_cloning_toolkit.py common recorder dataset model drive viz simulator web
SOURCES := $(ROOMS) tests benchmarks studies docs examples

# several tests at once (tests/conftest.py says how many); the tests of one file share fixtures
PYTEST := $(BIN)/python -m pytest -n auto --maxprocesses 8 --dist loadfile --no-loadscope-reorder

# tests start hundreds of processes: Python may always write compiled modules, so that each is compiled once
test test-installed test-long coverage: export PYTHONDONTWRITEBYTECODE :=

.PHONY: install install-dev demo test test-installed test-long coverage bench check check-style check-types check-types-windows docs site pictures proto foxglove-reader azurite lerobot-reader donkeycar clean

# PyTorch's build: cpu, cuda, or by itself: cuda where a driver of NVIDIA is found (elsewhere than on Linux, PyTorch has one build)
TORCH := $(if $(wildcard /proc/driver/nvidia/version /dev/nvidiactl /dev/dxg),cuda,cpu)
TORCH_CPU_INDEX := https://download.pytorch.org/whl/cpu
PIP := $(BIN)/python -m pip --disable-pip-version-check

# $(call install-torch,PIP): the build without CUDA, before what needs PyTorch; else PyPI's build has CUDA on Linux
ifeq ($(shell uname -s)-$(TORCH),Linux-cpu)
define install-torch
@echo "PyTorch without CUDA, because there is no NVIDIA driver here: 'make install TORCH=cuda' chooses otherwise."
$(1) --retries 1 --timeout 15 install --no-deps --index-url $(TORCH_CPU_INDEX) "$$(grep '^torch==' constraints.txt)" || \
  echo "$(TORCH_CPU_INDEX) has no build for this Python, or is out of reach: PyTorch with CUDA, 4 GB more."
endef
endif

# for users; the targets for tests, checks and docs install more
install: $(VENV)/installed

$(VENV)/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(call install-torch,$(PIP))
	@echo "Installing PyTorch, Rerun and other packages into $(VENV): a few minutes, and 2 GB of disk (with CUDA: 6.5 GB)."
	$(PIP) install -c constraints.txt -e .
	@touch $@
	@echo "Installed, $$(du -sh $(VENV) | cut -f1). The commands are in $(BIN): type $(BIN)/bc-demo,"
	@echo "or once in each terminal 'source $(BIN)/activate', then bc-demo."

install-dev: $(VENV)/installed-dev

$(VENV)/installed-dev: $(VENV)/installed
	$(PIP) install -c constraints.txt -e ".[dev]"
	@touch $@

demo: install
	$(BIN)/bc-demo

# what needs more than that is skipped; the last lines say how much, why, and how to get it
test: $(VENV)/installed-dev
	$(PYTEST) -m "not long"

# the wheel, installed as the README says, and every command and page of it; then each extra
test-installed: $(VENV)/installed-dev
	rm -rf build/installed build/lib build/bdist.*
	$(PIP) wheel --quiet --no-deps --wheel-dir build/installed .
	$(PYTHON) -m venv build/installed/base
	$(call install-torch,build/installed/base/bin/python -m pip)
	build/installed/base/bin/python -m pip install --quiet -c constraints.txt build/installed/*.whl
	$(PYTEST) tests/installed

# slow tests (each byte damaged, each moment stopped), and tests of random inputs with twenty times as many inputs
test-long: $(VENV)/installed-dev
	$(PYTEST) -m "long or hypothesis" --hypothesis-profile=long

# a few tests fail under coverage: those of full disks and of Ctrl-C
coverage: export COVERAGE_FILE := $(CURDIR)/build/coverage/data
coverage: $(VENV)/installed-dev
	rm -rf build/coverage && mkdir -p build/coverage
	-COVERAGE_PROCESS_START=$(CURDIR)/pyproject.toml $(PYTEST) --junitxml=build/coverage/junit.xml
	$(BIN)/coverage combine -q build/coverage
	$(BIN)/coverage report --precision=2 >build/coverage/report.txt
	@tail -1 build/coverage/report.txt

# time of a training step, an index and a reply, compared with an earlier version: ARGS="--base COMMIT" names it
bench: $(VENV)/installed-dev
	$(BIN)/python benchmarks/bench.py $(ARGS)

# `make -j check` takes half the time
check: check-style check-types check-types-windows

check-style: $(VENV)/installed-dev
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/ruff format --check $(SOURCES)

check-types: $(VENV)/installed-dev
	$(BIN)/mypy

check-types-windows: $(VENV)/installed-dev
	$(BIN)/mypy --platform win32 --cache-dir .mypy_cache/win32 $(ROOMS)

docs: $(VENV)/installed-dev
	$(BIN)/python docs/make_commands.py
	$(BIN)/python docs/make_architecture.py

site: $(VENV)/installed-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "build/site/index.html"

$(VENV)/installed-docs: $(VENV)/installed-dev
	$(PIP) install --quiet -c constraints.txt -e ".[docs]"
	@touch $@

pictures: $(VENV)/installed-dev
	$(BIN)/python docs/make_pictures.py

# the protoc of protobuf 5.29, so that bc_pb2.py works with every protobuf from 5.29 on
proto:
	$(PYTHON) -m venv build/protoc
	build/protoc/bin/pip install --quiet "grpcio-tools==1.71.2"
	build/protoc/bin/python -m grpc_tools.protoc -I. --python_out=. --pyi_out=. recorder/bc.proto

# Foxglove's own reader of MCAP files, for tests/recorder/test_other_readers.py; needs npm
foxglove-reader:
	npm ci --prefix tests/helpers/foxglove_reader

# Azure's emulator, for the test of az:// in tests/recorder/test_other_stores.py (`make test-long`); needs npm
azurite:
	npm install --prefix build/azurite --no-audit --no-fund azurite@3.35.0

# LeRobot in its own environment, for tests/recorder/test_lerobot_itself.py; needs Python 3.12 or newer.
# TORCH_INDEX: PyTorch's wheels without CUDA; with CUDA, the environment takes 3 GB more on Linux
lerobot-reader: TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
lerobot-reader:
	$(PYTHON) -m venv build/lerobot
	build/lerobot/bin/pip install --quiet "torch<2.12" "torchvision<0.27" --index-url $(TORCH_INDEX)
	build/lerobot/bin/pip install --quiet "lerobot[training]==0.6.*"

# DonkeyCar in its own environment, for tests/model/test_donkeycar_itself.py; needs Python 3.11
donkeycar: DONKEYCAR_PYTHON ?= python3.11
donkeycar:
	$(DONKEYCAR_PYTHON) -m venv build/donkeycar
	build/donkeycar/bin/pip install --quiet "donkeycar==5.*" onnxruntime

clean:
	rm -rf $(VENV) build .mypy_cache .pytest_cache .ruff_cache .hypothesis *.egg-info
