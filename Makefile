# The README's two commands are `make demo` and `make test`. Everything happens in .venv*; nothing else is touched.
PYTHON ?= python3
VENV := .venv
VENV2 := .venv-numpy2
BIN := $(VENV)/bin
OUT ?= demo-out
LEARN_OUT ?= demo-learn-out
HAND_OUT ?= hand-out
MODELS := src/corporeal/model/open_models
SCAN ?= assets/demo/scan.ply
PIP_INSTALL := pip install --quiet --disable-pip-version-check -c constraints.txt
# The detector draws in OpenCV, whose default wheel wants the system's libGL; the headless one has the same
# modules and runs on a bare machine.
HEADLESS := $(BIN)/$(PIP_INSTALL) --no-deps --force-reinstall opencv-contrib-python-headless
export OMP_WAIT_POLICY := PASSIVE

.PHONY: demo demo-learn hand registrations hand-joints test bench lint assets clean numpy2

demo: $(VENV)/.demo
	$(BIN)/corporeal register $(SCAN) -o $(OUT) --json $(OUT)/result.json
	@echo "Results are in $(OUT)/$(basename $(notdir $(SCAN)))/: open overview.png for a look, hand.glb in any glTF viewer."

# Six people and twelve poses are what two cores simulate, register and learn from in five minutes.
demo-learn: $(VENV)/.demo
	$(BIN)/corporeal pipeline $(LEARN_OUT)/session -o $(LEARN_OUT) --simulate --subjects 6 --poses 12 --rounds 1 \
		--name demo-hand --pictures --json $(LEARN_OUT)/result.json
	@echo "Results are in $(LEARN_OUT)/: model.npz is the hand, model.shape.png and model.pose.png show its components,"
	@echo "model.glb opens in any glTF viewer, its shape components as morph targets."

# A hand from the registrations in the repository: ten minutes on two cores. To put one in the box, convert it with
# --precision float16 and run assets/calibrate_detector.py on the copy.
hand: $(VENV)/.demo
	$(BIN)/python assets/registered_hands.py unpack $(HAND_OUT)/registered
	$(BIN)/corporeal learn $(HAND_OUT)/registered -o $(HAND_OUT)/hand.npz --name hand --start-shape-weight 1

# Those registrations, from nothing, in two rounds: an hour and a half on two cores, three on slow ones, and 6 GB in
# HAND_OUT. Resumable, but for the hand between the rounds (three minutes).
registrations: $(VENV)/.demo
	$(BIN)/corporeal simulate $(HAND_OUT)/session --subjects 31 --poses 51 --seed 0
	$(BIN)/corporeal register $(HAND_OUT)/session -o $(HAND_OUT)/round-1 --model soft_hand
	$(BIN)/corporeal learn $(HAND_OUT)/round-1 -o $(HAND_OUT)/round-1.npz --name hand --start-shape-weight 1
	$(BIN)/corporeal register $(HAND_OUT)/session -o $(HAND_OUT)/round-2 --model $(HAND_OUT)/round-1.npz \
		--landmarks-from $(HAND_OUT)/round-1
	$(BIN)/python assets/registered_hands.py pack $(HAND_OUT)/round-2 --start soft_hand

# The joints of soft_hand, by the scans of that session: four minutes, after `make registrations`, which is then due
# again. `make assets` leaves it with the joints of start_hand.
hand-joints: $(VENV)/.demo
	$(BIN)/corporeal joints $(HAND_OUT)/round-1 -o $(MODELS)/soft_hand.npz --start soft_hand --name soft_hand \
		--precision float16

# Work is stolen from the end of the other's half: dealt out in turns, both workers made the dear fixtures of every file.
# They share the cores: a second BLAS thread each costs more than it saves.
test numpy2: export OPENBLAS_NUM_THREADS := 1
test numpy2: export OMP_NUM_THREADS := 1
# Both environments are installed at once: that is mostly waiting.
test:
	$(MAKE) --no-print-directory -j2 $(VENV)/.test $(VENV2)/.test
	$(MAKE) --no-print-directory lint
	$(BIN)/python -m pytest -q -n auto --dist worksteal
	$(MAKE) --no-print-directory numpy2

# The detector's wheel holds numpy at 1.26; without it the newest numpy is used, and must work as well. Tests
# marked slow (over five seconds: browsers, kills, whole sessions, examples) run once, above, and so do those of the
# commands, which call what is tested in the other rooms.
numpy2: $(VENV2)/.test
	NUMBA_CACHE_DIR=$(VENV2)/numba $(VENV2)/bin/python -m pytest -q -n auto --dist worksteal -m "not slow" \
		--ignore tests/cli

lint: $(VENV)/.test
	$(BIN)/ruff format --check src tests benchmarks examples assets
	$(BIN)/ruff check src tests benchmarks examples assets
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(VENV)/.test
	-$(BIN)/python benchmarks/skinning.py
	-$(BIN)/python benchmarks/closest_points.py
	-$(BIN)/python benchmarks/real_scans.py

assets: $(VENV)/.demo
	$(PYTHON) -m venv .venv-assets
	.venv-assets/bin/$(PIP_INSTALL) -e '.[assets]'
	.venv-assets/bin/python assets/build.py
	$(BIN)/python assets/calibrate_detector.py --hand $(MODELS)/start_hand.npz
	.venv-assets/bin/python assets/tetrahedralise_hand.py
	.venv-assets/bin/python assets/learn_hand_correctives.py
	.venv-assets/bin/python assets/build_body.py --out build/body
	$(BIN)/corporeal merge build/body/body.npz hand --name body --hand-pose full --most-joints 4 -o $(MODELS)/body.npz \
		--precision float16
	.venv-assets/bin/python assets/tetrahedralise_body.py
	.venv-assets/bin/python assets/learn_body_correctives.py
	.venv-assets/bin/python assets/add_body_poses.py
	$(BIN)/python assets/calibrate_body_detector.py
	$(BIN)/python assets/calibrate_face_detector.py
	cp build/body/body_sexes.npz $(MODELS)/
	.venv-assets/bin/python assets/add_hand_size.py
	.venv-assets/bin/python assets/demo/build_scan.py
	.venv-assets/bin/python assets/hand_simulator/build.py
	.venv-assets/bin/python assets/body_simulator/build.py

$(VENV)/.demo: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/$(PIP_INSTALL) -e '.[detect,draco]'
	$(HEADLESS)
	touch $@

$(VENV)/.test: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/$(PIP_INSTALL) -e '.[detect,test]'
	$(HEADLESS)
	touch $(VENV)/.demo $@

$(VENV2)/.test: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV2)
	$(VENV2)/bin/$(PIP_INSTALL) -e '.[test]'
	touch $@

clean:
	rm -rf $(VENV) $(VENV2) .venv-assets demo-out demo-learn-out hand-out build dist
