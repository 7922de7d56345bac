/* job_kinds: what the jobs of a run render. Each takes a few seconds of one core when nobody disturbs it. */
#ifndef LIGHTMILL_CHAOS_JOB_KINDS_H
#define LIGHTMILL_CHAOS_JOB_KINDS_H

#include <stdbool.h>
#include <stddef.h>

typedef struct {
    const char *name;
    const char *options[12];  /* of submit and render: all that the image depends on but the seed */
    const char *terms[6];     /* of submit alone */
    const char *extended_spp; /* NULL: the job is not extended when it is done */
    bool paused;              /* it is paused and resumed on the way */
} job_kind_t;

static const job_kind_t JOB_KIND_LIST[] = {
    {.name = "hidden", .options = {"scenes/seed-hidden", "--resolution", "64x64", "--spp", "384"}},
    {.name = "caustic", .options = {"scenes/caustic", "--resolution", "80x60", "--spp", "300"}},
    /* A film that takes a while to write. */
    {.name = "large", .options = {"scenes/cornell", "--resolution", "640x480", "--spp", "4"}},
    {.name = "no layers",
     .options = {"scenes/textures", "--resolution", "96x64", "--spp", "256", "--no-layers"}},
    {.name = "path",
     .options = {"scenes/lights-env", "--resolution", "64x64", "--spp", "512", "--integrator", "path"}},
    {.name = "materials", .options = {"scenes/materials", "--resolution", "64x64", "--spp", "256"}},
    {.name = "light",
     .options = {"scenes/instances", "--resolution", "64x64", "--spp", "512", "--integrator", "light"}},
    {.name = "independent",
     .options = {"scenes/lens", "--resolution", "50x70", "--spp", "256", "--sampler", "independent"}},
    {.name = "extended",
     .options = {"scenes/cornell", "--resolution", "64x64", "--spp", "128"},
     .extended_spp = "300"},
    {.name = "urgent",
     .options = {"scenes/seed-specular", "--resolution", "64x64", "--spp", "128"},
     .terms = {"--priority", "3"}},
    {.name = "paused",
     .options = {"scenes/seed-diffuse", "--resolution", "64x64", "--spp", "200"},
     .paused = true},
};

enum { JOB_KINDS = sizeof JOB_KIND_LIST / sizeof JOB_KIND_LIST[0] };

#endif
