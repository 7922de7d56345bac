/* references: see references.h. */
#include "tests/chaos/jobs/references.h"

#include "common/image/image.h"

#include <stdlib.h>

static const double LIMIT = 600; /* seconds for a render */

static void render(const references_t *references, reference_t *reference)
{
    words_t words = {0};
    job_text_t text = {0};
    words_add(&words, "render");
    job_kind_words(reference->kind, references->smaller, reference->seed, reference->extended, &words, &text);
    WORDS_ADD(&words, "--quiet", "-o", reference->image);
    char *output = mem_printf("%s.log", reference->image);
    command_start(&reference->render, output, words.list, true);
    free(output);
}

const reference_t *references_get(references_t *references, const job_kind_t *kind, unsigned seed,
                                  bool extended)
{
    for (size_t i = 0; i < references->count; i++) {
        const reference_t *made = &references->list[i];
        if (made->kind == kind && made->seed == seed && made->extended == extended) return made;
    }
    reference_t *reference = &references->list[references->count++];
    *reference = (reference_t){.kind = kind, .seed = seed, .extended = extended};
    reference->image = mem_printf("%s/reference-%s-%u%s.exr", references->folder, kind->name, seed,
                                  extended ? "-extended" : "");
    render(references, reference);
    return reference;
}

result_t references_hash(const char *path, hash_t *hash)
{
    image_t image;
    TRY(image_read_exr(path, &image));
    *hash = image_hash(&image);
    image_free(&image);
    return result_ok();
}

static void tick(references_t *references, reference_t *reference, double now)
{
    command_state_t state = command_poll(&reference->render, now, LIMIT);
    if (state == COMMAND_DONE)
        reference->ready = references_hash(reference->image, &reference->hash).code == RESULT_OK;
    if (state == COMMAND_FAILED || (state == COMMAND_DONE && !reference->ready))
        report_violation(references->report, "%s cannot be rendered", reference->image);
}

void references_tick(references_t *references, double now)
{
    for (size_t i = 0; i < references->count; i++) tick(references, &references->list[i], now);
}

void references_free(references_t *references)
{
    for (size_t i = 0; i < references->count; i++) {
        command_end(&references->list[i].render);
        free(references->list[i].image);
    }
    references->count = 0;
}
