/* learning: see learning.h. */
#include "common/film/learning.h"

#include <string.h>

bool job_learns(const job_settings_t *settings)
{
    return settings->learn && settings->integrator == INTEGRATOR_BDPT && settings->strategy_t == 0;
}

uint32_t learning_passes(const job_settings_t *settings)
{
    return settings->adaptive ? LEARNING_ADAPTIVE_PASSES : LEARNING_PASSES;
}

uint32_t learning_pass(const job_settings_t *settings, uint32_t sample)
{
    uint32_t pass = 0;
    while (pass + 1 < learning_passes(settings) && sample >= learning_pass_begin(settings, pass + 1)) pass++;
    return pass;
}

uint32_t learning_pass_begin(const job_settings_t *settings, uint32_t pass)
{
    if (pass >= learning_passes(settings)) return UINT32_MAX;
    return pass == 0 ? 0 : UINT32_C(1) << pass;
}

uint32_t learning_teachers(uint32_t pass)
{
    return pass < 2 ? 0 : pass - 1;
}

bool learning_ready(const job_settings_t *settings, uint32_t sample, uint32_t plans)
{
    if (!job_learns(settings)) return true;
    uint32_t pass = learning_pass(settings, sample);
    return learning_teachers(pass) == 0 || (plans >> pass & 1) != 0;
}

uint32_t learning_taught(const job_settings_t *settings)
{
    return learning_teachers(learning_passes(settings) - 1);
}

/* ---- as a blob ----------------------------------------------------------------------------------------- */

static const char magic[8] = "LMPLAN2";

typedef struct {
    char magic[sizeof magic];
    uint32_t pass, teachers;
    hash_t content;
} plan_header_t;
_Static_assert(sizeof(plan_header_t) % sizeof(int64_t) == 0, "lessons follow it");

size_t learning_plan_bytes(void)
{
    return sizeof(plan_header_t) + LEARNING_PLACES * sizeof(int64_t);
}

/* Copies what bytes `at` to before at + size of a blob, which are at `from`, have in common with `length`
 * bytes from `offset` on. */
static void copy_part(const void *from, uint64_t at, size_t size, uint64_t offset, uint8_t *bytes,
                      size_t length)
{
    uint64_t begin = at > offset ? at : offset;
    uint64_t end = at + size < offset + length ? at + size : offset + length;
    if (begin < end) memcpy(bytes + (begin - offset), (const uint8_t *)from + (begin - at), end - begin);
}

enum { STEP = 1024 }; /* lessons that are added up at a time, in the cache */
_Static_assert(LEARNING_PLACES % STEP == 0, "steps cross passes");

static void sum_step(uint32_t pass, const int64_t *lessons, size_t first, int64_t sums[STEP])
{
    memcpy(sums, lessons + first, STEP * sizeof *sums);
    for (uint32_t teacher = 1; teacher < learning_teachers(pass); teacher++)
        for (size_t i = 0; i < STEP; i++) sums[i] += lessons[(size_t)LEARNING_PLACES * teacher + first + i];
}

void learning_plan_write(uint32_t pass, const int64_t *lessons, const hash_t *content, uint64_t offset,
                         uint8_t *bytes, size_t length)
{
    plan_header_t header = {.pass = pass, .teachers = learning_teachers(pass), .content = *content};
    int64_t sums[STEP];
    memcpy(header.magic, magic, sizeof magic);
    copy_part(&header, 0, sizeof header, offset, bytes, length);
    size_t first = offset > sizeof header ? (size_t)(offset - sizeof header) / sizeof sums * STEP : 0;
    for (; first < LEARNING_PLACES; first += STEP) {
        uint64_t at = sizeof header + first * sizeof *sums;
        if (at >= offset + length) break;
        sum_step(pass, lessons, first, sums);
        copy_part(sums, at, sizeof sums, offset, bytes, length);
    }
}

result_t learning_plan_read(const uint8_t *bytes, size_t size, const hash_t *content, learning_plan_t *plan)
{
    plan_header_t header;
    if (size < sizeof header) return result_fail(RESULT_INPUT, "a plan of %zu bytes", size);
    memcpy(&header, bytes, sizeof header);
    if (memcmp(header.magic, magic, sizeof magic) != 0) return result_fail(RESULT_INPUT, "this is no plan");
    if (header.pass >= LEARNING_PASSES || header.teachers != learning_teachers(header.pass) ||
        size != learning_plan_bytes())
        return result_fail(RESULT_INPUT, "a plan of pass %u with %zu bytes", header.pass, size);
    if (memcmp(&header.content, content, sizeof *content) != 0)
        return result_fail(RESULT_MISMATCH, "a plan of another job");
    *plan = (learning_plan_t){.pass = header.pass,
                              .teachers = header.teachers,
                              .lessons = (const int64_t *)(const void *)(bytes + sizeof header)};
    return result_ok();
}
