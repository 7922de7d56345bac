/* settings: see settings.h. */
#include "client/scene/settings.h"

#include <ctype.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

result_t option_error(const option_t *option, const char *text, void *field)
{
    double *value = field;
    result_t result = option_share(option, text, value);
    if (result.code == RESULT_OK && *value > 0 && *value < 1) return result;
    return result_fail(RESULT_USAGE, "--%s takes a number between 0 and 1, such as 0.01 or 1%%, not '%.100s'",
                       option->name, text);
}

result_t job_number_parse(const char *text, uint64_t *job)
{
    char *end;
    errno = 0;
    *job = strtoull(text, &end, 10);
    if (!isdigit((unsigned char)text[0]) || *end != '\0' || errno != 0 || *job == 0)
        return result_fail(RESULT_USAGE, "'%.100s' is no job number; see lightmill status", text);
    return result_ok();
}

/* Reads one of the numbers of --save-at; *text moves behind it, and behind the comma when a number follows.
 */
static bool read_count(const char **text, uint32_t *count)
{
    char *end;
    errno = 0;
    unsigned long value = strtoul(*text, &end, 10);
    if (!isdigit((unsigned char)**text) || errno != 0 || value < 1 || value > JOB_MAX_SPP) return false;
    *count = (uint32_t)value;
    *text = end[0] == ',' && end[1] != '\0' ? end + 1 : end;
    return *text > end || *end == '\0';
}

static result_t parse_save_at(const option_t *option, const char *text, void *field)
{
    save_at_t *save_at = field;
    *save_at = (save_at_t){.count = 0};
    for (const char *rest = text; *rest != '\0' || save_at->count == 0;) {
        uint32_t last = save_at->count > 0 ? save_at->spp[save_at->count - 1] : 0;
        if (save_at->count == JOB_MAX_SAVES)
            return result_fail(RESULT_USAGE, "--%s takes at most %d numbers", option->name, JOB_MAX_SAVES);
        if (!read_count(&rest, &save_at->spp[save_at->count]) || save_at->spp[save_at->count] <= last)
            return result_fail(RESULT_USAGE,
                               "--%s takes rising numbers of samples, such as 16,64,256, not '%.100s'",
                               option->name, text);
        save_at->count++;
    }
    return result_ok();
}

static result_t parse_resolution(const option_t *option, const char *text, void *field)
{
    overrides_t *overrides = field;
    int width, height, used = 0;
    if (sscanf(text, "%d%*1[xX]%d%n", &width, &height, &used) != 2 || text[used] != '\0' || width < 1 ||
        height < 1 || width > JOB_MAX_RESOLUTION || height > JOB_MAX_RESOLUTION)
        return result_fail(RESULT_USAGE, "--%s takes WIDTHxHEIGHT up to %d a side, not '%.100s'",
                           option->name, JOB_MAX_RESOLUTION, text);
    overrides->width = width;
    overrides->height = height;
    return result_ok();
}

static result_t parse_seed(const option_t *option, const char *text, void *field)
{
    overrides_t *overrides = field;
    char *end;
    errno = 0;
    overrides->seed = strtoull(text, &end, 0);
    overrides->has_seed = true;
    if (!isdigit((unsigned char)text[0]) || *end != '\0' || errno != 0)
        return result_fail(RESULT_USAGE, "--%s takes a whole number below 2^64, not '%.100s'", option->name,
                           text);
    return result_ok();
}

static const option_t rows[] = {
    OPTION(overrides_t, spp, "spp", "N", "samples a pixel", OPTION_RANGE(1, JOB_MAX_SPP)),
    OPTION(overrides_t, time_limit, "time", "SECONDS", "stop after so long, with --spp whichever comes first",
           OPTION_RANGE(0.1, 1e9)),
    OPTION_BY(option_error, overrides_t, error, "error", "E",
              "stop when the estimated relative error is at most E (0.01 or 1%, a good picture), with --spp "
              "and --time whichever comes first"),
    OPTION(overrides_t, adaptive, "adaptive", NULL,
           "more samples where there is more noise; --spp is their mean"),
    OPTION_BY(
        parse_save_at, overrides_t, save_at, "save-at", "N,N,...",
        "keep the images at these numbers of samples a pixel too, each the same as that of --spp N; they go "
        "beside the image: a.exr, a-0016.exr, ..."),
    OPTION_BY(
        option_choice, overrides_t, integrator, "integrator", "NAME",
        "bdpt, path or light; vcm: bdpt with photons, for caustics that are seen through glass or in "
        "mirrors: consistent, but not unbiased; ao: ambient occlusion, how open to all sides what is seen "
        "lies, without lights or materials",
        .choices = integrator_names),
    OPTION(overrides_t, max_depth, "max-depth", "N", "longest path: N + 1 segments, as pbrt counts",
           OPTION_RANGE(0, JOB_MAX_DEPTH)),
    {.name = "seed",
     .argument = "N",
     .help = "random numbers; the same seed makes the same image, bit by bit",
     .parse = parse_seed},
    {.name = "resolution", .argument = "WxH", .help = "pixels", .parse = parse_resolution},
    OPTION_BY(option_choice, overrides_t, sampler, "sampler", "NAME", "sobol or independent",
              .choices = sampler_names),
    OPTION(overrides_t, tile_size, "tile-size", "N", "pixels a side of the pieces that the image is cut into",
           OPTION_RANGE(JOB_MIN_TILE, JOB_MAX_TILE)),
    OPTION(
        overrides_t, film_scale, "film-scale", "N",
        "sums count in units of 2^-N (default: as the brightest light allows, at most 32); take less when a "
        "job fails because its sums were too large",
        OPTION_RANGE(FILM_MIN_SCALE, FILM_MAX_SCALE)),
    OPTION(overrides_t, no_learn, "no-learn", NULL,
           "all samples alike: later ones are not placed by what earlier ones show (bdpt)"),
    OPTION(overrides_t, merge_radius, "merge-radius", "R",
           "merge photons within R scene units at first (vcm; default: the width of two pixels)",
           OPTION_RANGE(1e-30, JOB_MAX_MERGE_RADIUS)),
    OPTION(
        overrides_t, spectral, "spectral", NULL,
        "light has wavelengths, not red, green and blue: glass disperses, and measured spectra count as they "
        "are (bdpt, path, light)"),
    OPTION(overrides_t, no_layers, "no-layers", NULL,
           "without the layers of what is seen: albedo, normal, position, depth, ..."),
    OPTION(
        overrides_t, cryptomatte, "cryptomatte", NULL,
        "with mattes of objects and of materials, as compositing programs read them: layers crypto_object00, "
        "crypto_material00, ..."),
    OPTION(
        overrides_t, light_groups, "light-groups", "GROUPS",
        "a pair of layers for each group of lights, which lightmill mix mixes anew: NAME=LIGHTS,..., such as "
        "key=3+4,sky=infinite, by number, kind or place in the scene file (lightmill info SCENE lists them); "
        "lights in no group make the group rest; or kinds: a group a kind; each: a group a light; at most 8 "
        "groups"),
};
const option_group_t settings_options = OPTION_GROUP("How to render (default: as the scene says)", rows);

/* What a film of this size shows of a camera whose window follows the film: the shorter side spans 1. */
static void window_of(int32_t width, int32_t height, double window[2])
{
    double aspect = (double)width / height;
    window[0] = fmax(aspect, 1);
    window[1] = fmax(1 / aspect, 1);
}

void settings_tell_cut(const overrides_t *overrides, const scene_blob_t *blob)
{
    const blob_scene_t *scene = blob->scene;
    int32_t width = overrides->width, height = overrides->height;
    if (width == 0) return;
    double change = (double)width / height / ((double)scene->width / scene->height);
    /* Half a pixel more or less is rounding. */
    if (fabs(change - 1) * fmax(width, height) < 1 || fabs(change - 1) < 1e-3) return;
    const float *w = scene->screen_window;
    bool fixed = w[0] != 0 || w[1] != 0 || w[2] != 0 || w[3] != 0;
    if (fixed || scene->camera == CAMERA_SPHERICAL || scene->camera == CAMERA_EQUAL_AREA) {
        log_warning(
            "--resolution %dx%d has another aspect than the scene's %dx%d, whose camera has a window of "
            "its own: the picture is stretched to %.0f %% of its width",
            width, height, scene->width, scene->height, 100 * change);
        return;
    }
    double before[2], after[2];
    window_of(scene->width, scene->height, before);
    window_of(width, height, after);
    log_warning("--resolution %dx%d has another aspect than the scene's %dx%d: it shows %.0f %% of the width "
                "and %.0f %% of the height that the scene's camera frames",
                width, height, scene->width, scene->height, 100 * after[0] / before[0],
                100 * after[1] / before[1]);
}
