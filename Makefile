# Lightmill: one Makefile for everything. `make help` lists what it can do.

CC      ?= cc
CFLAGS  ?= -O3 -g
PREFIX  ?= /usr/local
BUILD   ?= build
# V=1 shows whole commands.
Q       := $(if $(V),,@)

# The one numeric baseline: every machine that has it makes the same bits. Nothing that changes values is allowed.
# -mtune changes none: bdpt gains 1 to 4 % by it.
BASELINE := -march=x86-64-v3 -mtune=skylake -ffp-contract=off -fno-math-errno -fno-trapping-math
WARNINGS := -Wall -Wextra -Wshadow -Wstrict-prototypes -Wmissing-prototypes -Wvla
PACKAGES := expat libmicrohttpd libzmq libprotobuf-c libsodium libzstd libpng zlib libturbojpeg libwebp draco OpenEXR jansson sqlite3 libcurl libmurmurhash
ifneq ($(filter-out help clean deps deps-dev deps-test deps-chaos census check check-fast demo asan tsan fuzz chaos hostile valgrind container-check sim bench bench-plot bench-mesh bench-grids bench-error references bench-environment bench-cycles bench-long bench-merge bench-farm bench-watch bench-link bench-large bench-textures bench-codec format lint,$(or $(MAKECMDGOALS),all)),)
PKG_CFLAGS := $(shell pkg-config --cflags $(PACKAGES) 2>/dev/null)
ifneq ($(.SHELLSTATUS),0)
$(error $(strip $(foreach package,$(PACKAGES),$(if $(shell pkg-config --exists $(package) && echo yes),,$(package)))) is missing: run make deps)
endif
PKG_LIBS   := $(shell pkg-config --libs $(filter-out OpenEXR,$(PACKAGES))) -lOpenEXRCore-3_1
endif
ALL_CFLAGS = -std=gnu17 -D_GNU_SOURCE $(BASELINE) $(WARNINGS) $(CFLAGS) $(SANITIZE) -I. -I$(BUILD) $(patsubst -I%,-isystem%,$(PKG_CFLAGS)) -pthread
# C++ is for shims before libraries that have no C interface.
ALL_CXXFLAGS = -std=gnu++17 -D_GNU_SOURCE $(BASELINE) -Wall -Wextra -Wshadow $(CFLAGS) $(SANITIZE) -fno-sanitize=vptr -I. $(patsubst -I%,-isystem%,$(PKG_CFLAGS)) -pthread
ALL_LIBS   = $(LDFLAGS) -Wl,--as-needed $(PKG_LIBS) -lembree3 -lmeshoptimizer -lblosc -lstdc++ -lm -pthread

sources     = $(sort $(shell find $(1) \( -name '*.c' -o -name '*.cc' \) ! -name main.c))
COMMON_SRC := $(call sources,common)
WIRE_SRC   := $(call sources,proto/wire)
UPLINK_SRC := $(call sources,proto/uplink)
SERVE_SRC  := $(call sources,proto/serve)
RENDER_SRC := $(call sources,worker/render)
WORKER_SRC := $(filter-out $(RENDER_SRC),$(call sources,worker))
MASTER_SRC := $(call sources,master)
RELAY_SRC  := $(call sources,relay)
CLIENT_SRC := $(call sources,client)
LIB_SRC    := $(COMMON_SRC) $(WIRE_SRC) $(UPLINK_SRC) $(SERVE_SRC) $(RENDER_SRC) $(WORKER_SRC) $(MASTER_SRC) $(RELAY_SRC) $(CLIENT_SRC)
SCHEMAS    := proto/wire/lightmill.proto master/store/record.proto
SCHEMA_C   := $(patsubst %.proto,$(BUILD)/%.pb-c.c,$(SCHEMAS))
objects     = $(patsubst %.cc,$(BUILD)/%.o,$(patsubst %.c,$(BUILD)/%.o,$(1)))
archive     = $(BUILD)/lib/lib$(1).a

PROGRAMS := $(BUILD)/lightmill $(BUILD)/lightmill-master $(BUILD)/lightmill-worker $(BUILD)/lightmill-relay
TEST_SRC := $(sort $(shell find tests/unit -name "*.c" 2>/dev/null) $(wildcard tests/statistics/*.c tests/farm/*.c))
TESTS    := $(patsubst tests/%.c,$(BUILD)/tests/%,$(filter tests/%,$(shell grep -l '^int main' $(TEST_SRC) /dev/null 2>/dev/null)))
# Not of C: the page in a browser; Prometheus, the Python package, and farms with peers of the second implementation.
PYTHON_TESTS := $(patsubst %.py,$(BUILD)/%,$(wildcard tests/farm/test_*.py tests/unit/tests/test_*.py))
TESTS    += $(BUILD)/tests/page/test_page $(PYTHON_TESTS)

all: $(PROGRAMS)

# A library a folder, so that a program links what it calls and nothing else.
$(call archive,common): $(call objects,$(COMMON_SRC))
$(call archive,wire):   $(call objects,$(WIRE_SRC)) $(BUILD)/proto/wire/lightmill.pb-c.o
$(call archive,uplink): $(call objects,$(UPLINK_SRC))
$(call archive,serve):  $(call objects,$(SERVE_SRC))
$(call archive,render): $(call objects,$(RENDER_SRC))
$(call archive,worker): $(call objects,$(WORKER_SRC))
$(call archive,master): $(call objects,$(MASTER_SRC)) $(BUILD)/master/store/record.pb-c.o $(BUILD)/web_files.o
$(call archive,relay):  $(call objects,$(RELAY_SRC))
$(call archive,client): $(call objects,$(CLIENT_SRC))
$(BUILD)/lib/%.a:
	@mkdir -p $(@D)
	$(Q)rm -f $@ && $(AR) crsD $@ $^

archives    = $(foreach name,$(1),$(call archive,$(name)))
LIBRARIES  := $(call archives,client master relay worker render uplink serve wire common)
$(BUILD)/lightmill-master: $(BUILD)/master/main.o $(call archives,master serve wire common)
$(BUILD)/lightmill-worker: $(BUILD)/worker/main.o $(call archives,worker render uplink wire common)
$(BUILD)/lightmill-relay:  $(BUILD)/relay/main.o $(call archives,relay uplink serve wire common)
$(BUILD)/lightmill:        $(BUILD)/client/main.o $(LIBRARIES)
$(PROGRAMS):
	@echo "  link $@"
	$(Q)$(CC) $(ALL_CFLAGS) -o $@ $^ $(ALL_LIBS)

$(SCHEMA_C): $(BUILD)/%.pb-c.c: %.proto
	@mkdir -p $(BUILD)
	$(Q)protoc-c --proto_path=. --c_out=$(BUILD) $<
$(SCHEMA_C:.c=.o): %.o: %.c | $(SCHEMA_C)
	$(Q)$(CC) $(ALL_CFLAGS) -c -o $@ $<
$(call objects,$(filter-out $(COMMON_SRC) $(RENDER_SRC),$(LIB_SRC)) $(wildcard */main.c) $(TEST_SRC) $(wildcard tests/*.c tests/*/*.c tests/chaos/*/*.c)): | $(SCHEMA_C)

# The page's files (web/), as a table of name, bytes and size that master/http/files.c reads.
WEB := $(sort $(wildcard web/*))
$(BUILD)/web_files.S: web $(WEB)
	@mkdir -p $(BUILD)
	$(Q){ i=0; echo '.section .rodata'; \
	    for file in $(WEB); do i=$$((i + 1)); \
	        printf 'name%d: .asciz "%s"\nbytes%d: .incbin "%s"\nend%d:\n' $$i $${file#web/} $$i $$file $$i; done; \
	    printf '.section .data.rel.ro,"aw"\n.balign 8\n.globl http_web_files\nhttp_web_files:\n'; \
	    for n in $$(seq $$i); do echo ".quad name$$n, bytes$$n, end$$n - bytes$$n"; done; \
	    printf '.quad 0, 0, 0\n.section .note.GNU-stack,"",@progbits\n'; } >$@
$(BUILD)/web_files.o: $(BUILD)/web_files.S
	$(Q)$(CC) $(SANITIZE) -c -o $@ $<

$(BUILD)/%.o: %.c
	@mkdir -p $(@D)
	@echo "  cc $<"
	$(Q)$(CC) $(ALL_CFLAGS) -MMD -MP -c -o $@ $<

$(BUILD)/%.o: %.cc
	@mkdir -p $(@D)
	@echo "  c++ $<"
	$(Q)$(CXX) $(ALL_CXXFLAGS) -MMD -MP -c -o $@ $<

# The library that writes grids shifts negative numbers.
$(BUILD)/tests/nanovdb_pack.o: override SANITIZE := $(if $(SANITIZE),$(SANITIZE) -fno-sanitize=shift)

$(call archive,tests): $(call objects,$(wildcard tests/*.c tests/*.cc))
$(BUILD)/tests/%: $(BUILD)/tests/%.o $(call archive,tests) $(LIBRARIES)
	@echo "  link $@"
	$(Q)$(CC) $(ALL_CFLAGS) -o $@ $(filter %.o,$^) $(filter %.a,$^) $(ALL_LIBS) -lcmocka

$(BUILD)/tests/unit/tests/test_corpus: $(call objects,$(wildcard tests/fuzz/*.c))
$(BUILD)/tests/unit/tests/test_proxy $(BUILD)/tests/farm/test_links: $(call objects,tests/chaos/proxy.c tests/chaos/stream.c tests/chaos/zmtp.c)
CHAOS := $(BUILD)/tests/chaos/chaos $(BUILD)/tests/chaos/world.so $(PROGRAMS)
$(BUILD)/tests/farm/test_chaos: $(call objects,tests/chaos/process.c tests/chaos/world.c) | $(CHAOS)
$(BUILD)/tests/chaos/chaos: $(call objects,$(filter-out %/world_preload.c,$(wildcard tests/chaos/*.c tests/chaos/*/*.c)))

$(BUILD)/tests/page/test_page: tests/page/test_page.sh tests/page/install.sh docker/packages.txt
	-$(Q)tests/page/install.sh $(BUILD)/page
	@mkdir -p $(@D)
	$(Q)install -m 755 $< $@

$(PYTHON_TESTS): $(BUILD)/%: %.py | $(PROGRAMS)
	@mkdir -p $(@D)
	$(Q)install -m 755 $< $@

$(BUILD)/tests/unit/tests/test_performance: | $(BUILD)/tests/bench/bench_embree

# The messages, for tests/kit.
KIT_TESTS  := $(filter $(BUILD)/tests/farm/test_kit%,$(PYTHON_TESTS))
KIT_SCHEMA := $(BUILD)/tests/kit/lightmill_pb2.py
$(KIT_SCHEMA): proto/wire/lightmill.proto
	@mkdir -p $(@D)
	$(Q)protoc --proto_path=$(<D) --python_out=$(@D) $<
$(KIT_TESTS): $(KIT_SCHEMA)

# Prometheus, for the tests that ask it what it thinks; a test fails where it cannot be had, the build does not.
prometheus:
	-$(Q)docker/unpack-packages.sh build/debian
$(BUILD)/tests/farm/test_monitoring $(BUILD)/tests/unit/master/test_http: | prometheus

# Loaded into programs of a chaos run, never linked.
$(BUILD)/tests/chaos/world.so: tests/chaos/world_preload.c
	@mkdir -p $(@D)
	@echo "  link $@"
	$(Q)$(CC) -std=gnu17 -D_GNU_SOURCE $(WARNINGS) -I. -O2 -shared -fPIC -o $@ $<
SIM_SRC := $(filter-out tests/sim/main.c,$(wildcard tests/sim/*.c))
$(BUILD)/tests/farm/test_scale $(BUILD)/tests/sim/main $(BUILD)/tests/bench/bench_farm $(BUILD)/tests/bench/bench_watch: $(call objects,$(SIM_SRC))

-include $(shell find $(BUILD) -name '*.d' 2>/dev/null)

# ---- tests ----------------------------------------------------------------------------------------------

# Builds in a make of its own, so that pkg-config is asked after `deps` has installed it.
JOBS     := $(if $(findstring -j,$(MAKEFLAGS)),,-j$(shell nproc))
SUBMAKE   = +$(MAKE) --no-print-directory

# The ten slowest unit tests: most wait for what is lost, late or slow.
SLOW_TESTS := http tiles worker shared_film tile_routes farm_checks relay image_writer checkpointer viewer
UNIT_TESTS := $(filter $(BUILD)/tests/unit/%,$(TESTS))
FAST_TESTS := $(filter-out $(foreach name,$(SLOW_TESTS),$(filter %/test_$(name),$(UNIT_TESTS))),$(UNIT_TESTS))
# All tests; or those of TEST="film relay", by the names of their programs without the test_.
CHOSEN      = $(if $(TEST),$(foreach name,$(TEST),$(or $(filter %/test_$(name),$(TESTS)),$(error there is no test_$(name)))),$(TESTS))
LAYERS      = tests/layers.sh $(BUILD)

check: deps-test
	$(SUBMAKE) $(JOBS) all tests
	$(LAYERS)
	$(SUBMAKE) run-tests

check-fast: deps-test
	$(SUBMAKE) $(JOBS) all fast-tests
	$(LAYERS)
	@tests/run.sh -j $(shell nproc) $(FAST_TESTS)

tests: $(CHOSEN)
fast-tests: $(FAST_TESTS)

run-tests: $(PROGRAMS) $(CHOSEN)
	@tests/run.sh -j $(shell nproc) $(if $(SANITIZE),--apart) $(CHOSEN)

# The address sanitizer runs everything, the thread sanitizer TSAN_TESTS: what has threads and sockets. The rest
# renders for long, which is some ten times slower under it.
TSAN_TESTS ?= $(patsubst tests/%.c,%,$(filter tests/farm/test_%,$(TEST_SRC))) \
    unit/master/test_shared_film unit/master/test_http unit/master/test_http_images unit/master/test_http_submit unit/master/test_master unit/worker/test_render_pool unit/proto/test_grants \
    unit/proto/test_wire unit/tests/test_proxy
asan tsan: export TEST_TIMEOUT ?= 3600
asan tsan: CHECKED_FLAGS = -O1 -g -fno-omit-frame-pointer
asan: SANITIZERS = -fsanitize=address,undefined -fno-sanitize-recover=undefined
tsan: SANITIZERS = -fsanitize=thread
# All but the browser's, which would run the sanitized programs against a person's patience.
asan: CHECKED_TESTS = TESTS="$(patsubst $(BUILD)/%,$(BUILD)/asan/%,$(filter-out %/test_page,$(TESTS)))"
tsan: CHECKED_TESTS = TESTS="$(TSAN_TESTS:%=$(BUILD)/tsan/tests/%)"
asan tsan: deps-test
	$(SUBMAKE) $(JOBS) BUILD=$(BUILD)/$@ CFLAGS="$(CHECKED_FLAGS)" SANITIZE="$(SANITIZERS)" $(CHECKED_TESTS) all tests
	$(SUBMAKE) BUILD=$(BUILD)/$@ CFLAGS="$(CHECKED_FLAGS)" SANITIZE="$(SANITIZERS)" $(CHECKED_TESTS) run-tests

# A master under valgrind that serves 50 jobs with real workers must leave nothing unfreed.
valgrind: deps-chaos
	$(SUBMAKE) $(JOBS) all
	tests/valgrind.sh $(BUILD)

# Real processes, killed, stopped, cut off and fed garbage for CHAOS_SECONDS; SEED repeats a list of faults.
CHAOS_SECONDS ?= 600
SEED          ?=
chaos: deps-chaos
	$(SUBMAKE) $(JOBS) chaos-programs
	$(BUILD)/tests/chaos/chaos --seconds $(CHAOS_SECONDS) $(SEED:%=--seed %) --folder $(BUILD) \
	    --least $$(($(CHAOS_SECONDS) / 3)) --least-kills $$(($(CHAOS_SECONDS) / 15))
chaos-programs: $(CHAOS)

# Workers that lie, by chance and so often that chance is ruled out: HOSTILE_RUNS of each sort.
HOSTILE_RUNS ?= 100
hostile: deps-test
	$(SUBMAKE) $(JOBS) all $(BUILD)/tests/farm/test_kit_verify
	HOSTILE_RUNS=$(HOSTILE_RUNS) $(BUILD)/tests/farm/test_kit_verify

# Imports every scene below DIR, and prints how many come in, and why the others do not.
census: deps
	$(SUBMAKE) $(JOBS) all
	tests/census.sh "$(DIR)" $(BUILD)

# Fuzzing: FUZZ_SECONDS for each of FUZZ_TARGETS, which are the tests/fuzz/fuzz_*.c by default.
FUZZ_SECONDS ?= 60
FUZZ_TARGETS ?= $(patsubst tests/fuzz/fuzz_%.c,%,$(wildcard tests/fuzz/fuzz_*.c))
FUZZ_CHECKS   = address,undefined,float-cast-overflow

fuzz: CHECKED_FLAGS = -O1 -g -fno-omit-frame-pointer
fuzz: SANITIZERS = -fsanitize=fuzzer-no-link,$(FUZZ_CHECKS) -fno-sanitize-recover=all
fuzz: deps-dev
	$(SUBMAKE) $(JOBS) CC=clang CXX=clang++ BUILD=$(BUILD)/fuzz CFLAGS="$(CHECKED_FLAGS)" SANITIZE="$(SANITIZERS)" \
	    $(FUZZ_TARGETS:%=$(BUILD)/fuzz/fuzz_%)
	tests/fuzz/run.sh $(BUILD)/fuzz $(FUZZ_SECONDS) $(FUZZ_TARGETS)

# libFuzzer calls LLVMFuzzerTestOneInput; every target has a name of its own, so that a test can hold them all.
$(BUILD)/fuzz_%: $(BUILD)/tests/fuzz/fuzz_%.o $(BUILD)/tests/fuzz/support.o $(BUILD)/tests/films.o $(LIBRARIES)
	@echo "  link $@"
	$(Q)$(CC) $(ALL_CFLAGS) -fsanitize=fuzzer -Wl,--defsym=LLVMFuzzerTestOneInput=fuzz_$* -o $@ $^ $(ALL_LIBS)

# ---- the rest -------------------------------------------------------------------------------------------

demo: deps
	$(SUBMAKE) $(JOBS) all
	tests/demo.sh $(BUILD) $(BUILD)/demo

# Takes minutes; done by hand, when the page has changed.
pictures: deps
	$(SUBMAKE) $(JOBS) all
	tests/page/install.sh $(BUILD)/page
	node tests/page/picture.mjs $(BUILD) docs

deps:
	@docker/install-packages.sh build

# Also what only tests need.
deps-test:
	@docker/install-packages.sh build test

deps-chaos:
	@docker/install-packages.sh build test chaos

deps-dev:
	@docker/install-packages.sh build run render import test chaos dev

# The simulated farm (tests/sim): SIM="--workers 500 ..."; about four minutes.
sim: deps-test
	$(SUBMAKE) $(JOBS) all $(BUILD)/tests/sim/main
	$(BUILD)/tests/sim/main $(SIM)

# The table of docs/performance.md: REFERENCES=FOLDER SEEDS=2 SPP=64 INTEGRATORS=bdpt,path SCENES="cornell caustic".
PERFORMANCE = tests/bench/performance.py --build $(BUILD) $(REFERENCES:%=--references %) $(SEEDS:%=--seeds %)
bench: deps-test
	$(SUBMAKE) $(JOBS) all $(BUILD)/tests/bench/bench_embree
	$(PERFORMANCE) $(if $(SPP),--spp "$(SPP)") $(if $(INTEGRATORS),--integrators "$(INTEGRATORS)") $(SCENES)

# Its plot: about five minutes on two cores.
bench-plot: SPP         ?= 4,16,64,256
bench-plot: INTEGRATORS ?= bdpt,path
bench-plot: SCENES      ?= cornell seed-hidden caustic materials
bench-plot: deps-test
	$(SUBMAKE) $(JOBS) all $(BUILD)/tests/bench/bench_embree
	$(PERFORMANCE) --spp "$(SPP)" --integrators "$(INTEGRATORS)" --plot docs/performance.svg $(SCENES)

# Time and memory that a mesh of a million triangles takes.
bench-mesh: deps-test
	$(SUBMAKE) $(JOBS) $(BUILD)/tests/bench/bench_mesh
	$(BUILD)/tests/bench/bench_mesh

# Time and memory that media in NanoVDB files of 500 x 500 x 500 voxels take: GRID=500 (docs/performance.md).
bench-grids: deps-test
	$(SUBMAKE) $(JOBS) $(BUILD)/tests/bench/bench_grids
	$(BUILD)/tests/bench/bench_grids $(GRID)

# What docs/convergence.md says of --error: about seven minutes on two cores; SEEDS=20 ERROR=0.01 SIZE=32 ADAPTIVE=1.
bench-error: deps-test
	$(SUBMAKE) $(JOBS) $(BUILD)/tests/bench/bench_error
	$(BUILD)/tests/bench/bench_error $(or $(SEEDS),10) $(or $(ERROR),0.01) $(or $(SIZE),64) $(if $(ADAPTIVE),adaptive)

# What docs/import.md says of --environment: half a minute.
bench-environment: deps-test
	$(SUBMAKE) $(JOBS) $(BUILD)/tests/bench/bench_environment
	$(BUILD)/tests/bench/bench_environment

# Beside the Cycles of Debian's Blender, which has to be installed: half an hour. CYCLES="--folder /tmp/cycles product"
bench-cycles: deps-test
	$(SUBMAKE) $(JOBS) all
	/usr/bin/python3 tests/bench/cycles/compare.py --build $(BUILD) $(CYCLES)

# Every integrator against all references that it can see: ten minutes on two cores.
references: deps-test
	$(SUBMAKE) $(JOBS) $(BUILD)/tests/statistics/test_references
	$(BUILD)/tests/statistics/test_references all

# What learning brings to long jobs: three quarters of an hour on two cores; SECONDS=600 SHORT=20 SEEDS=6 BUILDS="build /other/build"
# SCENES="ajar pool" FOLDER=/tmp/long (keeps the images).
bench-long: deps-test
	$(SUBMAKE) $(JOBS) all
	tests/bench/long.py $(patsubst %,--build %,$(or $(BUILDS),$(BUILD))) $(SECONDS:%=--seconds %) $(SHORT:%=--short %) $(SEEDS:%=--seeds %) $(FOLDER:%=--folder %) $(SCENES)

# The master's merge rate as a share of memcpy's (docs/scale.md).
bench-merge: deps-test
	$(SUBMAKE) $(JOBS) $(BUILD)/tests/bench/bench_merge
	$(BUILD)/tests/bench/bench_merge

# CPU time of a farm beside its rendering, and two workers against one: about fifteen minutes (docs/scale.md).
bench-farm: deps-test
	$(SUBMAKE) $(JOBS) all $(BUILD)/tests/bench/bench_farm
	$(BUILD)/tests/bench/bench_farm

# What a hundred people who watch cost a farm: two minutes (docs/scale.md).
bench-watch: deps-test
	$(SUBMAKE) $(JOBS) all $(BUILD)/tests/bench/bench_watch
	$(BUILD)/tests/bench/bench_watch

# What a worker behind 1 Mbit/s costs a job at 1920x1080: two minutes; SPP=12 doubles that (docs/workers.md).
bench-link: deps-test
	$(SUBMAKE) $(JOBS) all
	tests/bench/bench_link.sh $(BUILD) $(SPP)

# A farm with an image of 7680 x 4320 that people fetch meanwhile: seven minutes (docs/scale.md).
bench-large: deps
	$(SUBMAKE) $(JOBS) all
	tests/bench/large.sh $(BUILD)

# A scene with 4 GB of images in 1 GB of memory: minutes, as root, 14 GB of disk (docs/scale.md).
bench-textures: deps-test
	$(SUBMAKE) $(JOBS) all
	tests/bench/textures.sh $(BUILD)

# What docs/codec.md says of the alternatives to our payload coding.
bench-codec: deps-dev
	$(SUBMAKE) $(JOBS) $(BUILD)/tests/bench/bench_codec
	$(BUILD)/tests/bench/bench_codec

# Builds the images with buildah and renders a job through them; as root, some minutes.
container-check: deps
	@docker/install-packages.sh containers
	$(SUBMAKE) $(JOBS) all
	docker/check.sh $(BUILD)

# The programs write their manual pages themselves, from the tables that they read their command lines by.
man: $(PROGRAMS)
	@mkdir -p $(BUILD)/man
	$(Q)for program in $(PROGRAMS); do $$program --man >$(BUILD)/man/$${program##*/}.1 || exit 1; done
	$(Q)for command in $$($(BUILD)/lightmill --complete ''); do \
	    $(BUILD)/lightmill $$command --man >$(BUILD)/man/lightmill-$$command.1 || exit 1; done

INSTALL_TO  = $(DESTDIR)$(PREFIX)
COMPLETIONS = $(addprefix $(INSTALL_TO)/share/bash-completion/completions/,$(notdir $(PROGRAMS)))
install: $(PROGRAMS) man
	install -d $(INSTALL_TO)/bin $(INSTALL_TO)/share/man/man1 $(INSTALL_TO)/share/bash-completion/completions
	install -m 755 $(PROGRAMS) $(INSTALL_TO)/bin
	install -m 644 $(BUILD)/man/*.1 $(INSTALL_TO)/share/man/man1
	$(BUILD)/lightmill completion bash | tee $(COMPLETIONS) >/dev/null

uninstall:
	rm -f $(addprefix $(INSTALL_TO)/bin/,$(notdir $(PROGRAMS))) $(COMPLETIONS) $(INSTALL_TO)/share/man/man1/lightmill*.1

OUR_C  = $(shell git ls-files '*.c' 2>/dev/null)
OUR_CC = $(shell git ls-files '*.cc' 2>/dev/null)
OUR_H  = $(shell git ls-files '*.h' 2>/dev/null)
OUR_SH = .ci/run $(shell git ls-files '*.sh' 2>/dev/null)
format:
	clang-format -i $(OUR_C) $(OUR_CC) $(OUR_H)

# Of cppcheck: a result_t holds no pointer; texels hold floats; NULL is a pointer here; a factor is never 0; an assert_true
# that fails ends the test.
CPPCHECK_NOISE := normalCheckLevelMaxBranches returnDanglingLifetime invalidPointerCast varFuncNullUB \
    zerodivcond:common/film/film.c negativeIndex:tests/farm/test_flood.c \
    arrayIndexOutOfBoundsCond:tests/unit/master/test_schedule.c
# How far clang-tidy's analyser looks into what a function calls. Shallow takes a tenth of the time of deep, and sees less;
# what it has seen does not count as seen by deep. A file is looked at again when its object was made again.
ANALYSIS ?= deep
TIDY_OK   = $(BUILD)/lint/$(ANALYSIS)
TIDY      = clang-tidy --quiet $< -- $(filter-out -ffp-contract=% -fno-trapping-math,$(1)) -Xclang -analyzer-config -Xclang mode=$(ANALYSIS) \
    2>$@.log || { cat $@.log; exit 1; }
lint:
	@docker/install-packages.sh build test dev
	@echo '  clang-format, shellcheck'
	$(Q)clang-format --dry-run -Werror $(OUR_C) $(OUR_CC) $(OUR_H)
	$(Q)shellcheck --severity=warning $(OUR_SH)
	$(SUBMAKE) $(JOBS) lint-files
	@echo '  cppcheck'
	$(Q)cppcheck --quiet -j$(shell nproc) --std=c11 --std=c++17 --enable=warning,performance,portability \
	    $(CPPCHECK_NOISE:%=--suppress=%) --error-exitcode=1 -I. $(OUR_C) $(OUR_CC)
lint-files: $(OUR_C:%.c=$(TIDY_OK)/%.ok) $(OUR_CC:%.cc=$(TIDY_OK)/%.ok)
$(TIDY_OK)/%.ok: %.c $(BUILD)/%.o .clang-tidy
	@mkdir -p $(@D)
	@echo "  tidy $<"
	$(Q)$(call TIDY,$(ALL_CFLAGS))
	@touch $@

$(TIDY_OK)/%.ok: %.cc $(BUILD)/%.o .clang-tidy
	@mkdir -p $(@D)
	@echo "  tidy $<"
	$(Q)$(call TIDY,$(ALL_CXXFLAGS))
	@touch $@

# For editors and tools that ask how a file is compiled.
compdb: $(SCHEMA_C)
	@{ echo '['; for file in $(OUR_C); do \
	    printf '%s{"directory": "$(CURDIR)", "file": "%s", "command": "$(CC) $(ALL_CFLAGS) -c %s"}' "$$comma" $$file $$file; \
	    comma=','; done; echo ']'; } >compile_commands.json

clean:
	rm -rf $(BUILD)

help:
	@echo "make            build lightmill, lightmill-master, lightmill-worker and lightmill-relay in $(BUILD)/"
	@echo "make demo       render scenes/seed-hidden on a farm of three processes on this machine"
	@echo "make check      install what is missing, build, run all tests; TEST=\"film relay\" runs these"
	@echo "make check-fast the unit tests without the ten slow ones: seconds"
	@echo "make asan       the tests under the address and undefined-behaviour sanitizers (tsan: threads)"
	@echo "make chaos      a farm to which everything happens, for CHAOS_SECONDS ($(CHAOS_SECONDS)); SEED repeats a run"
	@echo "make hostile    workers that lie in some of their batches are found, HOSTILE_RUNS ($(HOSTILE_RUNS)) times of each sort"
	@echo "make valgrind   a master that served 50 jobs has no leaks"
	@echo "make fuzz       libFuzzer on all that decodes bytes of others: FUZZ_SECONDS ($(FUZZ_SECONDS)) each; FUZZ_TARGETS=\"pbrt ply\""
	@echo "make census DIR=...  imports every scene below a folder, and prints a table of what comes in"
	@echo "make sim        a real master and 500 simulated workers for three minutes: what one master takes"
	@echo "make container-check  build the images of docker/Dockerfile, render a job through them (root)"
	@echo "make bench      error and CPU time of the renderer against pbrt-v3's: REFERENCES, SEEDS, SPP, INTEGRATORS, SCENES"
	@echo "make bench-plot   error against CPU time for four scenes: docs/performance.svg"
	@echo "make references  every integrator against all reference images: ten minutes"
	@echo "make bench-mesh   time and memory for a mesh of a million triangles"
	@echo "make bench-grids  time and memory for media in NanoVDB files of 500^3 voxels"
	@echo "make bench-error  jobs that end by --error: is it the error? SEEDS, ERROR, SIZE, ADAPTIVE"
	@echo "make bench-long   what learning brings to long jobs: 45 minutes; SECONDS, SHORT, SEEDS, BUILDS, SCENES, FOLDER"
	@echo "make bench-environment  --environment against a dome of triangles with the same image"
	@echo "make bench-cycles  error and time beside Blender's Cycles (CYCLES=options)"
	@echo "make bench-merge  how fast a master merges, as a share of memcpy"
	@echo "make bench-farm   CPU time of a farm beside its rendering; two workers against one"
	@echo "make bench-watch  what a hundred people who watch a job cost the farm"
	@echo "make bench-large  checkpoints, fetches and memory with an image of 7680 x 4320"
	@echo "make bench-textures  a scene with 4 GB of images in 1 GB of memory"
	@echo "make bench-link  what a worker behind 1 Mbit/s costs a job"
	@echo "make bench-codec  the codings of payloads that were weighed against one another"
	@echo "make pictures   the pictures of the page in docs/, of a farm that renders scenes/seed-hidden: minutes"
	@echo "make man        the manual pages, in $(BUILD)/man"
	@echo "make install    into PREFIX ($(PREFIX)); DESTDIR is honoured; uninstall takes it back"
	@echo "make deps       the Debian packages that building needs; deps-test: also tests; deps-dev: also format and lint"
	@echo "make format     clang-format; make lint: is the format right, and do clang-tidy, cppcheck and shellcheck find nothing?"
	@echo "make compdb     compile_commands.json for editors"
	@echo "make clean      remove $(BUILD)/"

.PHONY: all census check check-fast references bench bench-plot bench-mesh bench-grids bench-error bench-environment bench-cycles bench-long bench-codec tests fast-tests run-tests asan tsan fuzz demo pictures deps deps-dev deps-chaos prometheus container-check install man uninstall format lint lint-files compdb clean help sim bench-merge bench-farm bench-watch bench-link bench-large bench-textures chaos chaos-programs hostile valgrind deps-test
.SECONDARY:
