# SPDX-License-Identifier: Apache-2.0
# Every target sets up what it needs; a second call does only what has changed. `make help` lists the targets.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

VENV := .venv
BIN := $(VENV)/bin
PYTHON := $(BIN)/python
# Executables of tpgmm_ros and tpgmm_demos
PROGRAMS := $(VENV)/lib/tpgmm_ros
DEMOS := $(VENV)/lib/tpgmm_demos
# One empty file for each finished step of the set-up; another name makes the environment anew once the steps have changed
DONE := $(VENV)/.steps

SEED ?= 1
# Of simulated time, for the soak; of real time, for the stress test
MINUTES ?= $(if $(filter stress,$(MAKECMDGOALS)),10,30)
# For `seeds`: numbers and ranges, separated by commas
SEEDS ?= 1001-1030
# Data sets of others, which are no part of the repository
DATA ?= ../shared/data

# The libraries of a sourced ROS installation or of another environment must not mix with those of the wheels
unexport PYTHONPATH PYTHONHOME LD_LIBRARY_PATH AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE
# Each process would compile the sources anew: a second of processor time
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help setup dev lint format test long mutants properties faults fuzz determinism seeds soak networks robots demo workbench bags results figures figure5 figure6 bench pages scaling stress colcon docs reference lock clean

help: ## list all targets
	@sed -nE 's/^([a-z0-9]+):.*## (.*)/  make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 20

setup: $(DONE)/packages $(DONE)/kernels ## install everything needed to run: virtual environment, ROS wheels, interface packages, compiled kernels

dev: setup $(DONE)/requirements-dev ## install everything needed to run and develop: also ruff, mypy, pytest, colcon

lint: dev ## check style and types: ruff, mypy
	$(PYTHON) -m ruff check
	$(PYTHON) -m ruff format --check
	$(call say,mypy (a minute; seconds from then on))
	@$(call progress,mypy) $(PYTHON) -m mypy

format: dev ## format the code in the project's style
	$(PYTHON) -m ruff check --fix
	$(PYTHON) -m ruff format

# $(1): which tests. A file of tests per core at a time, then those that need the machine for themselves. What fails is run once more without
# other tests beside it, which may have taken its cores: a fault of the code fails again.
define tests
failed=0; again() { echo "==> again what failed, by itself"; $(PYTHON) -m pytest --last-failed -m "$$1"; }; \
	$(PYTHON) -m pytest --numprocesses logical --maxprocesses 8 --dist loadfile --no-loadscope-reorder -m "not alone and $(1)" || again "not alone and $(1)" || failed=1; \
	$(PYTHON) -m pytest -m "alone and $(1)" || again "alone and $(1)" || failed=1; \
	exit $$failed
endef
test: lint ## run lint, then the tests, except those that `make long` runs
	@$(call tests,not long)

long: dev ## run the tests that repeat others in further situations, and take long
	@$(call tests,long)

properties: dev ## try 10 000 sequences of inputs: no torque and no rate exceeds its limit (`make test` tries fewer)
	TPGMM_PROPERTY_SEQUENCES=10000 $(PYTHON) -m pytest --timeout 3600 src/tpgmm_core/test/test_controller_properties.py

mutants: dev ## put known faults into a copy of the sources, one at a time; status 1 if no test notices one: out/mutants/ (10 minutes; ONLY=phase for some)
	$(PYTHON) tools/mutants.py $(if $(ONLY),--only $(ONLY))

fuzz: dev ## try 20 000 untrusted files and messages of each kind: valid, or refused with the reason (`make test` tries fewer)
	TPGMM_FUZZ_EXAMPLES=20000 $(PYTHON) -m pytest --timeout 7200 src/tpgmm_core/test/test_fuzz_model_file.py \
		src/tpgmm_core/test/test_fuzz_robot_file.py src/tpgmm_core/test/test_file_bombs.py src/tpgmm_ros/test/test_fuzz_messages.py \
		test/test_fuzz_nodes.py test/test_workbench_anything.py

determinism: setup ## run the demo in lockstep twice at 1 kHz and twice at 500 Hz and compare, bit by bit: out/determinism/ (SEED=7)
	PYTHONPATH=. $(PYTHON) benchmarks/determinism.py --seed $(SEED)

seeds: setup ## run the demo in lockstep in many situations and list failures with their causes: out/seeds/ (SEEDS=1001-1030)
	PYTHONPATH=. $(PYTHON) benchmarks/seeds.py --seeds $(SEEDS)

soak: setup ## run 30 minutes of simulated time with random faults, watch tasks and memory: out/soak/ (MINUTES=5 for less)
	PYTHONPATH=. $(PYTHON) benchmarks/soak.py --minutes $(MINUTES) --seed $(SEED)

networks: setup ## run the demo's task on three hosts whose network loses packets, is slow, and cuts off the camera: out/networks/ (Linux)
	PYTHONPATH=. $(PYTHON) benchmarks/networks.py --seed $(SEED)

robots: setup ## a Panda by torques, a UR5 by FollowJointTrajectory, a Panda behind crisp topics do the task, contracts are checked: out/robots/ (SLOWER=2 on two cores, more on busy ones)
	PYTHONPATH=.:test $(PYTHON) -m interfaces --seed $(SEED) $(if $(SLOWER),--slower $(SLOWER))

faults: dev ## cause every known fault in the running nodes and check how they react: out/faults/ (20 minutes; RATE=250 on slow cores)
	PYTHONPATH=.:test $(PYTHON) -m faults $(if $(RATE),--rate $(RATE))

demo: setup ## train a model, start the nodes, do the task, report: out/demo/ (SEED=7 for another situation, SEPARATE=1 for one process per node)
	$(DEMOS)/demo --seed $(SEED) $(if $(SEPARATE),--separate)

# Another folder is another project
PROJECT ?= out/workbench/project
workbench: setup ## serve a page to teach a simulated robot a skill and to run it, until Ctrl-C (PROJECT=folder, PORT=8080, ROBOT=robot file, TASK=task file; or URDF= for a robot without a robot file)
	$(PYTHON) -m tpgmm_workbench.simulated --project $(PROJECT) $(if $(PORT),--port $(PORT)) $(if $(ROBOT),--robot $(ROBOT)) \
		$(if $(TASK),--task $(TASK)) $(if $(URDF),--urdf $(URDF))

bags: setup ## record the demonstrations in bags/ again
	rm -rf bags/pick_place
	$(DEMOS)/scripted_lessons --perception exact --output bags/pick_place

SETS = --set config/baxter_valve.yaml $(DATA)/baxter_valve --set config/franka_bolts.yaml $(DATA)/franka_bolts \
	--set config/pick_place.yaml bags/pick_place
results: setup ## compute the numbers of docs/reference/results.md: leave-one-out on real demonstrations (hours; DATA=directory of the data sets)
	$(PROGRAMS)/train --task config/baxter_valve.yaml --leave-one-out --report out/results/baxter_valve \
		$(DATA)/baxter_valve
	PYTHONPATH=. $(PYTHON) benchmarks/valve_selection.py --data $(DATA)/baxter_valve
	PYTHONPATH=. $(PYTHON) benchmarks/retrieval_table.py --data $(DATA)
	PYTHONPATH=. $(PYTHON) benchmarks/irrelevant_frames.py $(SETS)
	PYTHONPATH=. $(PYTHON) benchmarks/hidden_frames.py $(SETS)
	PYTHONPATH=. $(PYTHON) benchmarks/automatic.py $(SETS)
	PYTHONPATH=.:src/tpgmm_core/test $(PYTHON) benchmarks/recognition.py --data $(DATA)

figures: setup ## draw figures 1 to 4 of the paper, weights of frames, extrapolation: out/figures/ (DATA=directory of the data sets)
	@for number in 1 2 3 4; do PYTHONPATH=. $(PYTHON) examples/figure$$number.py || exit 1; done
	PYTHONPATH=. $(PYTHON) examples/frame_weights.py
	PYTHONPATH=. $(PYTHON) examples/extrapolation.py --data $(DATA)/pbdlib

figure5: setup ## figure 5 of the paper, a cup and a sugar cube in two hands, with pushes: out/figure5/ (20 minutes; SEED=7 for other pushes)
	$(DEMOS)/figure5 --seed $(SEED)

figure6: setup ## figure 6 of the paper, priorities of two hands of a planar robot: out/figures/, out/kinematic_relevance/ (3 minutes)
	PYTHONPATH=. $(PYTHON) examples/figure6.py
	PYTHONPATH=. $(PYTHON) examples/kinematic_relevance.py

BENCHMARKS := em reproduction_step retrieval_step lqr control simulator loop latency kinematic_frames
bench: setup ## run the benchmarks: tables, and JSON in out/bench/; status 1 if one does not reach its bounds (needs two idle cores)
	@failed=""; for name in $(BENCHMARKS); do PYTHONPATH=.:src/tpgmm_core/test $(PYTHON) benchmarks/$$name.py || failed="$$failed $$name"; \
		done; if [ -n "$$failed" ]; then echo "not reached:$$failed"; exit 1; fi

pages: setup ## open ten pages of the workbench at once, without browsers; what they cost, also the loop, and whether each can stop: out/bench/
	PYTHONPATH=. $(PYTHON) benchmarks/pages.py
	PYTHONPATH=. $(PYTHON) benchmarks/loop_page.py

scaling: setup ## run the benchmarks of learning, 100 dimensions and a million samples: out/high_dimension/, out/scaling/
	PYTHONPATH=. $(PYTHON) benchmarks/high_dimension.py
	PYTHONPATH=. $(PYTHON) benchmarks/scaling.py

SPHINX := $(PYTHON) -m sphinx --quiet --fail-on-warning --keep-going -d out/docs/doctrees -c docs
docs: setup $(DONE)/requirements-docs ## build a site from the pages, with the API: out/docs/html/index.html (2 minutes)
	@mkdir -p out/docs && rm -rf out/docs/source && cp -a docs out/docs/source
	$(SPHINX) out/docs/source out/docs/html

reference: setup ## update the reference pages of nodes, topics, messages and programs from the sources
	$(PYTHON) tools/reference_pages.py

lock: $(DONE)/requirements-dev ## resolve requirements*.in into requirements*.txt, keep locked versions that still fit (UPGRADE=1: use the newest)
	tools/lock $(BIN)/uv $(if $(UPGRADE),--upgrade)

stress: setup ## run nodes at 1 kHz while incompatible peers come and go, check that no node stops: out/executor_stress/ (MINUTES=10)
	PYTHONPATH=. $(PYTHON) benchmarks/executor_stress.py --minutes $(MINUTES)

# As on a full installation, beside what the other targets build. TESTS="-k frame" for some tests only
COLCON := PATH="$(CURDIR)/$(BIN):$$PATH" AMENT_PREFIX_PATH="$(CURDIR)/$(VENV)" CMAKE_PREFIX_PATH="$(CURDIR)/$(VENV)" \
	$(BIN)/colcon --log-base out/colcon/log
COLCON_PLACES := --base-paths src --build-base out/colcon/build --install-base out/colcon/install
colcon: dev ## build and test the packages with colcon: out/colcon/ (15 minutes; TESTS="-k frame" for some tests)
	$(COLCON) build --metas colcon.meta $(COLCON_PLACES)
	$(COLCON) test $(COLCON_PLACES) --executor sequential --event-handlers console_direct+ --return-code-on-test-failure \
		--packages-select tpgmm_core tpgmm_ros tpgmm_demos tpgmm_workbench $(if $(TESTS),--pytest-args $(TESTS))

clean: ## remove everything that the other targets created
	rm -rf $(VENV) out .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find src test benchmarks examples tools -name __pycache__ -prune -exec rm -rf {} +

# --- the steps of the set-up ---

say = @printf '\033[1m==> %s\033[0m\n' "$(1)"
# Says every ten seconds what a long command is at; what it writes goes to .venv/log
progress = $(PYTHON) tools/progress.py $(VENV)/log/$(1).log

$(DONE)/venv: .python-version
	$(call say,virtual environment (some seconds))
	@python=$$(tools/check_system) && $$python -m venv --clear $(VENV)
	@mkdir -p $(DONE) && touch $@

$(DONE)/requirements: requirements.txt tools/install_requirements.py tools/relocate_wheels.py $(DONE)/venv
	$(call say,wheels for running: 162 (some 2 minutes))
	@$(PYTHON) tools/install_requirements.py requirements.txt
	@$(PYTHON) tools/relocate_wheels.py
	@touch $@

$(DONE)/requirements-dev: requirements-dev.txt $(DONE)/requirements
	$(call say,wheels for developing: 51 (some 20 seconds))
	@$(PYTHON) tools/install_requirements.py requirements-dev.txt
	@touch $@

$(DONE)/requirements-docs: requirements-docs.txt $(DONE)/requirements
	$(call say,wheels for the site: 22 (some 20 seconds))
	@$(PYTHON) tools/install_requirements.py requirements-docs.txt
	@touch $@

# The wheels make the environment a ROS prefix. What is built here joins them, so that every process of the environment
# finds it without a setup.bash: libraries, interfaces, and executables in lib/<package>, where `ros2 run` looks too
$(DONE)/interfaces: export PATH := $(CURDIR)/$(BIN):$(PATH)
$(DONE)/interfaces: export AMENT_PREFIX_PATH := $(CURDIR)/$(VENV)
$(DONE)/interfaces: export CMAKE_PREFIX_PATH := $(CURDIR)/$(VENV)
$(DONE)/interfaces: $(DONE)/requirements $(shell find src/tpgmm_msgs -type f)
	$(call say,interface package (some 30 seconds))
	@$(call progress,interfaces-configure) cmake -S src/tpgmm_msgs -B $(VENV)/build/tpgmm_msgs \
		-DCMAKE_INSTALL_PREFIX=$(CURDIR)/$(VENV) -DCMAKE_BUILD_TYPE=Release -DBUILD_TESTING=OFF
	@$(call progress,interfaces-build) cmake --build $(VENV)/build/tpgmm_msgs --parallel $$(nproc)
	@$(call progress,interfaces-install) cmake --install $(VENV)/build/tpgmm_msgs
	@touch $@

# Not built where they are installed already
$(DONE)/standard-interfaces: export PATH := $(CURDIR)/$(BIN):$(PATH)
$(DONE)/standard-interfaces: export AMENT_PREFIX_PATH := $(CURDIR)/$(VENV)
$(DONE)/standard-interfaces: export CMAKE_PREFIX_PATH := $(CURDIR)/$(VENV)
$(DONE)/standard-interfaces: $(DONE)/requirements tools/build_interfaces.py tools/standard_interfaces.yaml
	$(call say,interfaces of ROS that the wheels lack: tf2_msgs, vision_msgs, control_msgs (some 2 minutes))
	@$(call progress,standard-interfaces) $(PYTHON) tools/build_interfaces.py tools/standard_interfaces.yaml $(CURDIR)/$(VENV)
	@touch $@

PACKAGE_FILES := $(foreach package,tpgmm_core tpgmm_ros tpgmm_demos tpgmm_workbench,$(addprefix src/$(package)/,setup.py setup.cfg package.xml))
INSTALLED_DATA := $(wildcard src/tpgmm_ros/launch/*.launch.py config/*.yaml)
$(DONE)/packages: tools/link_packages.py $(DONE)/interfaces $(DONE)/standard-interfaces $(PACKAGE_FILES) $(INSTALLED_DATA)
	$(call say,Python packages (some seconds))
	@$(PYTHON) tools/link_packages.py src/tpgmm_core src/tpgmm_ros src/tpgmm_demos src/tpgmm_workbench
	@touch $@

# A compiled function keeps what it was compiled from, also when a function of another file that it calls has changed.
# Level 2 of LLVM takes a fifth less time than 3, and what it makes is as fast.
COMPILED := $(shell grep -rlE "compiled|inlined|njit" src/tpgmm_core/tpgmm_core --include="*.py")
$(DONE)/kernels: $(DONE)/packages $(COMPILED)
	$(call say,compiled kernels (2 minutes; more beside other work))
	@find src/tpgmm_core/tpgmm_core -name "*.nb[ic]" -delete
	@$(call progress,kernels) env NUMBA_OPT=2 $(PYTHON) -m tpgmm_core.warm_up
	@touch $@
