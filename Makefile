# Needs Python 3.11 or newer and make; everything else is installed into .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
ROOMS := behavioural_cloning_toolkit.py common recorder dataset model drive viz simulator web
SOURCES := $(ROOMS) tests benchmarks studies docs examples

# several tests at once (tests/conftest.py says how many); those of one file share what they have made
PYTEST := $(BIN)/python -m pytest -n auto --maxprocesses 8 --dist loadfile --no-loadscope-reorder

# compiled once, and not by each of the hundreds of processes that tests start, whatever the environment says
test test-browser test-long coverage: export PYTHONDONTWRITEBYTECODE :=

.PHONY: install install-dev demo test test-browser test-long coverage bench check docs site pictures proto foxglove-reader azurite lerobot-reader donkeycar clean

# what people need; tests, checks and docs install what they need besides
install: $(VENV)/installed

$(VENV)/installed: pyproject.toml constraints.txt
	@echo "Installing into $(VENV): PyTorch, Rerun and what else is needed; a few minutes, and 2 GB of disk, several more"
	@echo "where PyTorch comes with its GPU libraries (on Linux, unless CPU-only wheels are asked for)."
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --disable-pip-version-check -c constraints.txt -e ".[web]"
	@touch $@
	@echo "Installed, $$(du -sh $(VENV) | cut -f1). The commands are in $(BIN): type $(BIN)/bc-demo,"
	@echo "or 'source $(BIN)/activate' once in a terminal, and then bc-demo."

install-dev: $(VENV)/installed-dev

$(VENV)/installed-dev: $(VENV)/installed
	$(BIN)/pip install --disable-pip-version-check -c constraints.txt -e ".[dev]"
	@touch $@

demo: install
	$(BIN)/bc-demo

test: $(VENV)/installed-dev
	$(PYTEST) -m "not long and not browser"

# pages driven in Chromium, which must be installed
test-browser: $(VENV)/installed-dev
	$(PYTEST) -m "browser and not long"

# what takes long by nature (every byte, every moment), and twenty times the examples of what holds for whatever is given
test-long: $(VENV)/installed-dev
	$(PYTEST) -m "long or hypothesis" --hypothesis-profile=long

# a few tests fail where everything is measured: those of full disks and of Ctrl-C
coverage: export COVERAGE_FILE := $(CURDIR)/build/coverage/data
coverage: $(VENV)/installed-dev
	rm -rf build/coverage && mkdir -p build/coverage
	-COVERAGE_PROCESS_START=$(CURDIR)/pyproject.toml $(PYTEST) --junitxml=build/coverage/junit.xml
	$(BIN)/coverage combine -q build/coverage
	$(BIN)/coverage report --precision=2 >build/coverage/report.txt
	@tail -1 build/coverage/report.txt

# training step, index and reply, next to those of an earlier version; `ARGS="--base COMMIT"` chooses it
bench: $(VENV)/installed-dev
	$(BIN)/python benchmarks/bench.py $(ARGS)

check: $(VENV)/installed-dev
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/mypy
	$(BIN)/mypy --platform win32 --cache-dir .mypy_cache/win32 $(ROOMS)

docs: $(VENV)/installed-dev
	$(BIN)/python docs/make_commands.py
	$(BIN)/python docs/make_architecture.py

site: $(VENV)/installed-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "build/site/index.html"

$(VENV)/installed-docs: $(VENV)/installed-dev
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[docs]"
	@touch $@

pictures: $(VENV)/installed-dev
	$(BIN)/python docs/make_pictures.py

# bc_pb2.py for every protobuf from 5.29 on: written by the protoc of that time
proto:
	$(PYTHON) -m venv build/protoc
	build/protoc/bin/pip install --quiet "grpcio-tools==1.71.2"
	build/protoc/bin/python -m grpc_tools.protoc -I. --python_out=. --pyi_out=. recorder/bc.proto

# Foxglove's own reader of MCAP files, by which tests/recorder/test_other_readers.py reads logs; needs npm
foxglove-reader:
	npm ci --prefix tests/helpers/foxglove_reader

# Azure's emulator, on which tests/recorder/test_other_stores.py tries az:// in `make test-long`; needs npm
azurite:
	npm install --prefix build/azurite --no-audit --no-fund azurite@3.35.0

# LeRobot in an environment of its own, by which tests/recorder/test_lerobot_itself.py reads, writes and trains;
# needs Python 3.12 or newer, and on Linux 3 GB more without the index of PyTorch's wheels for processors
lerobot-reader: TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
lerobot-reader:
	$(PYTHON) -m venv build/lerobot
	build/lerobot/bin/pip install --quiet "torch<2.12" "torchvision<0.27" --index-url $(TORCH_INDEX)
	build/lerobot/bin/pip install --quiet "lerobot[training]==0.6.*"

# DonkeyCar in an environment of its own, in whose loop tests/model/test_donkeycar_itself.py drives; needs Python 3.11
donkeycar: DONKEYCAR_PYTHON ?= python3.11
donkeycar:
	$(DONKEYCAR_PYTHON) -m venv build/donkeycar
	build/donkeycar/bin/pip install --quiet "donkeycar==5.*" onnxruntime

clean:
	rm -rf $(VENV) build .mypy_cache .pytest_cache .ruff_cache .hypothesis *.egg-info
