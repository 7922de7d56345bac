# Lightmill: one Makefile for everything. `make help` lists what it can do.

CC      ?= cc
CFLAGS  ?= -O3 -g
PREFIX  ?= /usr/local
BUILD   ?= build

# The one numeric baseline: every machine that has it makes the same bits. Nothing that changes values is allowed.
BASELINE := -march=x86-64-v3 -ffp-contract=off -fno-math-errno -fno-trapping-math
WARNINGS := -Wall -Wextra -Wshadow -Wstrict-prototypes -Wmissing-prototypes -Wvla
PACKAGES := libzmq libczmq libprotobuf-c libsodium libzstd blosc libpng OpenEXR
ifneq ($(filter-out help clean deps,$(or $(MAKECMDGOALS),all)),)
PKG_CFLAGS := $(shell pkg-config --cflags $(PACKAGES) 2>/dev/null)
PKG_LIBS   := $(shell pkg-config --libs $(filter-out OpenEXR,$(PACKAGES)) 2>/dev/null) -lOpenEXRCore-3_1
endif
ALL_CFLAGS = -std=gnu17 -D_GNU_SOURCE $(BASELINE) $(WARNINGS) $(CFLAGS) $(SANITIZE) -I. -I$(BUILD) $(patsubst -I%,-isystem%,$(PKG_CFLAGS)) -pthread
ALL_LIBS   = $(LDFLAGS) $(PKG_LIBS) -lembree3 -lm -pthread

COMMON_SRC := $(wildcard common/*.c)
PROTO_SRC  := $(wildcard proto/*.c)
RENDER_SRC := $(wildcard worker/render/*.c)
WORKER_SRC := $(filter-out worker/main.c,$(wildcard worker/*.c))
MASTER_SRC := $(filter-out master/main.c,$(wildcard master/*.c))
CLIENT_SRC := $(filter-out client/main.c,$(wildcard client/*.c client/import/*.c client/import/*/*.c))
LIB_SRC    := $(COMMON_SRC) $(PROTO_SRC) $(RENDER_SRC) $(WORKER_SRC) $(MASTER_SRC) $(CLIENT_SRC)
SCHEMA_C   := $(BUILD)/proto/lightmill.pb-c.c
SCHEMA_O   := $(BUILD)/proto/lightmill.pb-c.o
objects     = $(patsubst %.c,$(BUILD)/%.o,$(1))

PROGRAMS := $(BUILD)/lightmill $(BUILD)/lightmill-master $(BUILD)/lightmill-worker
TEST_SRC := $(wildcard tests/unit/*.c tests/statistics/*.c tests/farm/*.c)
TESTS    := $(patsubst tests/%.c,$(BUILD)/tests/%,$(filter tests/%,$(shell grep -l '^int main' $(TEST_SRC) /dev/null 2>/dev/null)))

all: $(PROGRAMS)

$(BUILD)/lightmill-master: $(call objects,master/main.c $(MASTER_SRC) $(PROTO_SRC) $(COMMON_SRC)) $(SCHEMA_O)
$(BUILD)/lightmill-worker: $(call objects,worker/main.c $(WORKER_SRC) $(RENDER_SRC) $(PROTO_SRC) $(COMMON_SRC)) $(SCHEMA_O)
$(BUILD)/lightmill: $(call objects,client/main.c $(LIB_SRC)) $(SCHEMA_O)
$(PROGRAMS):
	$(CC) $(ALL_CFLAGS) -o $@ $^ $(ALL_LIBS)

$(BUILD)/proto/%.pb-c.c $(BUILD)/proto/%.pb-c.h: proto/%.proto
	@mkdir -p $(@D)
	protoc-c --proto_path=proto --c_out=$(@D) $<
$(SCHEMA_O): $(SCHEMA_C)
	$(CC) $(ALL_CFLAGS) -c -o $@ $<
$(call objects,$(PROTO_SRC) $(WORKER_SRC) $(MASTER_SRC) $(CLIENT_SRC)): | $(SCHEMA_C)

$(BUILD)/%.o: %.c
	@mkdir -p $(@D)
	$(CC) $(ALL_CFLAGS) -MMD -MP -c -o $@ $<

$(BUILD)/tests/%: $(BUILD)/tests/%.o $(call objects,$(LIB_SRC) $(wildcard tests/*.c)) $(SCHEMA_O)
	$(CC) $(ALL_CFLAGS) -o $@ $^ $(ALL_LIBS) -lcmocka

-include $(shell find $(BUILD) -name '*.d' 2>/dev/null)

clean:
	rm -rf $(BUILD)

.PHONY: all clean
.SECONDARY:
