/* job_kinds: see job_kinds.h. */
#include "tests/chaos/jobs/job_kinds.h"

#include <stdio.h>

/* A sanitizer makes everything slower: the jobs have fewer samples then. */
#if defined __SANITIZE_ADDRESS__ || defined __SANITIZE_THREAD__
enum { SLOWNESS = 8 };
#else
enum { SLOWNESS = 1 };
#endif

const job_kind_t JOB_KIND_LIST[JOB_KINDS] = {
    {.name = "hidden", .spp = 384, .options = {"scenes/seed-hidden", "--resolution", "64x64"}},
    {.name = "caustic", .spp = 300, .options = {"scenes/caustic", "--resolution", "80x60"}},
    /* A film that takes a while to write. */
    {.name = "large", .spp = 4, .options = {"scenes/cornell", "--resolution", "640x480"}, .deleted = true},
    {.name = "no layers", .spp = 256, .options = {"scenes/textures", "--resolution", "96x64", "--no-layers"}},
    {.name = "path",
     .spp = 512,
     .options = {"scenes/lights-env", "--resolution", "64x64", "--integrator", "path"}},
    {.name = "materials", .spp = 256, .options = {"scenes/materials", "--resolution", "64x64"}},
    {.name = "light",
     .spp = 512,
     .options = {"scenes/instances", "--resolution", "64x64", "--integrator", "light"}},
    {.name = "independent",
     .spp = 256,
     .options = {"scenes/lens", "--resolution", "50x70", "--sampler", "independent"}},
    {.name = "extended",
     .spp = 128,
     .options = {"scenes/cornell", "--resolution", "64x64"},
     .extended_spp = 300},
    {.name = "urgent",
     .spp = 128,
     .options = {"scenes/seed-specular", "--resolution", "64x64"},
     .terms = {"--priority", "3"}},
    {.name = "verified",
     .spp = 200,
     .options = {"scenes/lights-delta", "--resolution", "64x64"},
     .terms = {"--verify", "10%"}},
    {.name = "error", .options = {"scenes/cornell", "--resolution", "48x48", "--error", "0.03"}},
    {.name = "adaptive", .spp = 200, .options = {"scenes/caustic", "--resolution", "64x64", "--adaptive"}},
    {.name = "paused",
     .spp = 200,
     .options = {"scenes/seed-diffuse", "--resolution", "64x64"},
     .paused = true},
};

const char *job_kind_spp(const job_kind_t *kind, unsigned smaller, bool extended, job_text_t *text)
{
    unsigned spp = (extended ? kind->extended_spp : kind->spp) / SLOWNESS / smaller;
    snprintf(text->spp, sizeof text->spp, "%u", spp > 0 ? spp : 1);
    return text->spp;
}

void job_kind_words(const job_kind_t *kind, unsigned smaller, unsigned seed, bool extended, words_t *words,
                    job_text_t *text)
{
    snprintf(text->seed, sizeof text->seed, "%u", seed);
    words_add_all(words, kind->options);
    WORDS_ADD(words, "--seed", text->seed);
    if (kind->spp > 0) WORDS_ADD(words, "--spp", job_kind_spp(kind, smaller, extended, text));
}
