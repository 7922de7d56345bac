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

static const char magic[8] = "LMPLAN1";

typedef struct {
    char magic[sizeof magic];
    uint32_t pass, teachers;
    hash_t content;
} plan_header_t;
_Static_assert(sizeof(plan_header_t) % sizeof(int64_t) == 0, "lessons follow it");

static size_t lessons_bytes(uint32_t teachers)
{
    return (size_t)teachers * LEARNING_PLACES * sizeof(int64_t);
}

size_t learning_plan_bytes(uint32_t pass)
{
    return sizeof(plan_header_t) + lessons_bytes(learning_teachers(pass));
}

void learning_plan_write(const learning_plan_t *plan, const hash_t *content, uint8_t *bytes)
{
    plan_header_t header = {.pass = plan->pass, .teachers = plan->teachers, .content = *content};
    memcpy(header.magic, magic, sizeof magic);
    memcpy(bytes, &header, sizeof header);
    memcpy(bytes + sizeof header, plan->lessons, lessons_bytes(plan->teachers));
}

result_t learning_plan_read(const uint8_t *bytes, size_t size, const hash_t *content, learning_plan_t *plan)
{
    plan_header_t header;
    if (size < sizeof header) return result_fail(RESULT_INPUT, "a plan of %zu bytes", size);
    memcpy(&header, bytes, sizeof header);
    if (memcmp(header.magic, magic, sizeof magic) != 0) return result_fail(RESULT_INPUT, "this is no plan");
    if (header.pass >= LEARNING_PASSES || header.teachers != learning_teachers(header.pass) ||
        size != learning_plan_bytes(header.pass))
        return result_fail(RESULT_INPUT, "a plan of pass %u with %zu bytes", header.pass, size);
    if (memcmp(&header.content, content, sizeof *content) != 0)
        return result_fail(RESULT_MISMATCH, "a plan of another job");
    *plan = (learning_plan_t){.pass = header.pass,
                              .teachers = header.teachers,
                              .lessons = (const int64_t *)(const void *)(bytes + sizeof header)};
    return result_ok();
}
