/* picture: see picture.h. */
#include "common/film/picture.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

bool picture_half_fits(const char *channel)
{
    static const char *const floats[] = {"samples", "position.X", "position.Y", "position.Z",
                                         "depth.Z", "object.id",  "material.id"};
    for (size_t i = 0; i < ARRAY_LENGTH(floats); i++)
        if (strcmp(channel, floats[i]) == 0) return false;
    for (int k = 0; k < MATTE_KINDS; k++)
        if (strncmp(channel, matte_kind_names[k], strlen(matte_kind_names[k])) == 0) return false;
    return true;
}

/* Channels of interleaved values, one for each name. */
static void add_views(image_t *image, const char *const names[], size_t count, bool half, const float *data)
{
    for (size_t i = 0; i < count; i++) {
        pixel_type_t type = half && picture_half_fits(names[i]) ? PIXEL_HALF : PIXEL_FLOAT;
        image_add_view(image, names[i], type, data + i, count);
    }
}

static void add_layers(image_t *image, const film_image_t *film, bool half)
{
    const struct {
        const char *names[3];
        size_t count;
        const float *data;
    } layers[] = {{{"R", "G", "B"}, 3, film->sum},
                  {{"eye.R", "eye.G", "eye.B"}, 3, film->eye},
                  {{"light.R", "light.G", "light.B"}, 3, film->light},
                  {{"noise.R", "noise.G", "noise.B"}, 3, film->noise},
                  {{"samples"}, 1, film->samples},
                  {{"albedo.R", "albedo.G", "albedo.B"}, 3, film->albedo},
                  {{"normal.X", "normal.Y", "normal.Z"}, 3, film->normal},
                  {{"position.X", "position.Y", "position.Z"}, 3, film->position},
                  {{"depth.Z"}, 1, film->depth},
                  {{"object.id"}, 1, film->object},
                  {{"material.id"}, 1, film->material},
                  {{"coverage"}, 1, film->coverage},
                  {{"half0.R", "half0.G", "half0.B"}, 3, film->half[0]},
                  {{"half1.R", "half1.G", "half1.B"}, 3, film->half[1]}};
    for (size_t i = 0; i < ARRAY_LENGTH(layers); i++)
        if (layers[i].data != NULL) add_views(image, layers[i].names, layers[i].count, half, layers[i].data);
}

static void add_mattes(image_t *image, const film_image_t *film)
{
    for (int k = 0; k < MATTE_KINDS; k++)
        for (int l = 0; l < MATTE_LEVELS; l++)
            for (size_t c = 0; c < 4 && film->mattes[k][l] != NULL; c++) {
                char name[32];
                snprintf(name, sizeof name, "%s%02d.%c", matte_kind_names[k], l, "RGBA"[c]);
                image_add_view(image, name, PIXEL_FLOAT, film->mattes[k][l] + c, 4);
            }
}

/* What decoders look for. */
static void describe_mattes(image_t *image, const mattes_t *mattes)
{
    for (matte_kind_t k = 0; k < MATTE_KINDS; k++) {
        char key[MATTE_KEY];
        matte_key(k, key);
        const char *const entries[][2] = {{"name", matte_kind_names[k]},
                                          {"hash", "MurmurHash3_32"},
                                          {"conversion", "uint32_to_float32"},
                                          {"manifest", mattes->manifests[k]}};
        for (size_t i = 0; i < ARRAY_LENGTH(entries); i++) {
            char name[32];
            snprintf(name, sizeof name, "cryptomatte/%s/%s", key, entries[i][0]);
            if (entries[i][1] != NULL) image_set_string(image, name, entries[i][1]);
        }
    }
}

/* The layers of the light groups that the film has. */
static void add_groups(image_t *image, const film_image_t *film, const char *light_groups, bool half)
{
    for (uint32_t g = 0; g < light_groups_count(light_groups); g++) {
        char name[LIGHT_GROUP_NAME + 1], channels[6][2 * LIGHT_GROUP_NAME];
        const char *names[6];
        light_groups_name(light_groups, g, name);
        for (int c = 0; c < 6; c++) {
            snprintf(channels[c], sizeof channels[c], "group.%s.%s.%c", name, c < 3 ? "eye" : "light",
                     "RGB"[c % 3]);
            names[c] = channels[c];
        }
        if (film->group_eye[g] != NULL) add_views(image, names, 3, half, film->group_eye[g]);
        if (film->group_light[g] != NULL) add_views(image, names + 3, 3, half, film->group_light[g]);
    }
}

static void add_settings(image_t *image, const job_settings_t *settings)
{
    image_set_string(image, "lightmill.integrator", integrator_name(settings->integrator));
    image_set_string(image, "lightmill.sampler", sampler_name(settings->sampler));
    image_set_u64(image, "lightmill.seed", settings->seed);
    image_set_int(image, "lightmill.maxDepth", settings->max_depth);
    image_set_int(image, "lightmill.spp", (int32_t)settings->spp);
    image_set_float(image, "lightmill.timeLimit", (float)settings->time_limit);
    image_set_int(image, "lightmill.tileSize", settings->tile_size);
    image_set_int(image, "lightmill.filmScale", settings->film_scale);
    image_set_int(image, "lightmill.layers", settings->features);
    if (settings->cryptomatte) image_set_int(image, "lightmill.cryptomatte", 1);
    if (settings->error > 0) image_set_float(image, "lightmill.errorTarget", (float)settings->error);
    if (settings->adaptive) image_set_int(image, "lightmill.adaptive", 1);
    if (job_learns(settings)) image_set_int(image, "lightmill.learn", 1);
    if (settings->integrator == INTEGRATOR_VCM)
        image_set_string(
            image, "lightmill.bias",
            "consistent, not unbiased: merging blurs light, the less the more samples there are");
    if (settings->merge_radius > 0)
        image_set_float(image, "lightmill.mergeRadius", (float)settings->merge_radius);
    if (settings->spectral) image_set_int(image, "lightmill.spectral", 1);
    if (settings->light_groups[0] != '\0')
        image_set_string(image, "lightmill.lightGroups", settings->light_groups);
    if (settings->strategy_t == 0) return;
    image_set_int(image, "lightmill.strategyS", settings->strategy_s);
    image_set_int(image, "lightmill.strategyT", settings->strategy_t);
    image_set_int(image, "lightmill.unweighted", settings->unweighted);
}

static uint64_t total_samples(const film_image_t *film)
{
    size_t pixels = (size_t)film->width * (size_t)film->height;
    double total = 0;
    for (size_t p = 0; p < pixels; p++) total += (double)film->samples[p];
    return (uint64_t)total;
}

static void add_counts(image_t *image, uint64_t samples, const film_counts_t *counts)
{
    image_set_u64(image, "lightmill.samples", samples);
    image_set_u64(image, "lightmill.lightPaths", counts->light_paths[0] + counts->light_paths[1]);
    image_set_u64(image, "lightmill.rays", counts->rays);
    image_set_u64(image, "lightmill.dropped", counts->dropped);
    image_set_u64(image, "lightmill.overflows", counts->overflows);
    image_set_float(image, "lightmill.cpuSeconds", (float)(1e-6 * (double)counts->cpu_us));
}

void picture_describe(image_t *image, const picture_meta_t *meta, uint64_t samples)
{
    char hash[2 * HASH_BYTES + 1];
    hash_to_hex(&meta->scene, hash);
    image_set_string(image, "lightmill.version", LIGHTMILL_VERSION);
    image_set_string(image, "lightmill.sceneHash", hash);
    if (meta->scene_name != NULL) image_set_string(image, "lightmill.scene", meta->scene_name);
    add_settings(image, &meta->settings);
    add_counts(image, samples, &meta->counts);
    image_set_int(image, "lightmill.workers", (int32_t)meta->workers);
    image_set_float(image, "lightmill.wallSeconds", (float)meta->wall_seconds);
    hash_to_hex(&meta->bits, hash);
    if (!hash_is_zero(&meta->bits)) image_set_string(image, "lightmill.bits", hash);
    if (meta->note != NULL && meta->note[0] != '\0') image_set_string(image, "lightmill.note", meta->note);
}

result_t picture_write_exr(const char *path, const film_image_t *film, const picture_meta_t *meta, bool half)
{
    image_t image;
    image_init(&image, film->width, film->height);
    image.writing = meta->writing;
    add_layers(&image, film, half);
    add_mattes(&image, film);
    if (meta->mattes != NULL) describe_mattes(&image, meta->mattes);
    add_groups(&image, film, meta->settings.light_groups, half);
    picture_describe(&image, meta, total_samples(film));
    if (isfinite(film->error)) image_set_float(&image, "lightmill.error", (float)film->error);
    result_t result = image_write_exr(path, &image);
    image_free(&image);
    return result;
}

result_t picture_write_png(const char *path, const film_image_t *film, float exposure)
{
    static const char *const names[] = {"R", "G", "B"};
    image_t image;
    image_init(&image, film->width, film->height);
    add_views(&image, names, 3, false, film->sum);
    result_t result = image_write_png(path, &image, exposure);
    image_free(&image);
    return result;
}

char *picture_png_path(const char *path)
{
    const char *slash = strrchr(path, '/'), *name = slash != NULL ? slash + 1 : path;
    const char *dot = strrchr(name, '.');
    size_t stem = dot != NULL && dot != name ? (size_t)(dot - path) : strlen(path);
    return mem_printf("%.*s.png", (int)stem, path);
}
