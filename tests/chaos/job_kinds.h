/* job_kinds: what the jobs of a run render. Each takes a few seconds of one core when nobody disturbs it. */
#ifndef LIGHTMILL_CHAOS_JOB_KINDS_H
#define LIGHTMILL_CHAOS_JOB_KINDS_H

#include <stdbool.h>
#include <stddef.h>

typedef struct {
    const char *name;
    const char
        *options[12];      /* of submit and render: what the image depends on, but the seed and the samples */
    const char *terms[6];  /* of submit alone */
    unsigned spp;          /* samples a pixel; 0: the options say when it ends, */
    unsigned extended_spp; /* and to so many it is extended when it is done; 0: it is not */
    bool paused;           /* it is paused and resumed on the way */
} job_kind_t;

static const job_kind_t JOB_KIND_LIST[] = {
    {.name = "hidden", .spp = 384, .options = {"scenes/seed-hidden", "--resolution", "64x64"}},
    {.name = "caustic", .spp = 300, .options = {"scenes/caustic", "--resolution", "80x60"}},
    /* A film that takes a while to write. */
    {.name = "large", .spp = 4, .options = {"scenes/cornell", "--resolution", "640x480"}},
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

enum { JOB_KINDS = sizeof JOB_KIND_LIST / sizeof JOB_KIND_LIST[0] };

#endif
