/* images: see images.h.
 *
 * pbrt-v4 tells formats by the name of the file. Of alpha it keeps that of EXR files and of PNG files that
 * have a channel of it. It heeds the chromaticities of an EXR file where they are those of a colour space
 * that it knows; skies from its imgtool are ACES's. What gets negative outside of sRGB's gamut is 0, as in
 * rgb parameters.
 */
#include "client/import/pbrt/state/images.h"
#include "client/import/pbrt/state/colour_spaces.h"

#include <float.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

bool pbrt_has_extension(const char *filename, const char *extension)
{
    size_t length = strlen(filename), size = strlen(extension);
    return length > size && strcasecmp(filename + length - size, extension) == 0;
}

static bool keeps_alpha(const char *name, const texture_image_t *pixels)
{
    return pbrt_has_extension(name, ".exr") || (pbrt_has_extension(name, ".png") && !pixels->alpha_expanded);
}

/* Of four channels the first three. */
static void drop_alpha(texture_image_t *pixels)
{
    size_t texel = pixels->type == TEXELS_U8 ? 1 : sizeof *pixels->floats;
    size_t count = (size_t)pixels->width * pixels->height;
    uint8_t *at = pixels->type == TEXELS_U8 ? pixels->bytes : (uint8_t *)pixels->floats;
    for (size_t i = 1; i < count; ++i) memmove(at + 3 * i * texel, at + 4 * i * texel, 3 * texel);
    pixels->channels = 3;
}

/* Which space the colours of a file are of, 0 for sRGB. */
static size_t space_of(pbrt_t *p, const char *name, position_t at, const texture_image_t *pixels)
{
    size_t space = 0;
    const float(*c)[2] = pixels->chromaticities;
    if (!pixels->has_chromaticities || pbrt_find_colour_space(c, &space)) return space;
    report_warning(p->report, at,
                   "%s: no colour space of pbrt-v4 has red (%g, %g), green (%g, %g), blue (%g, %g) and white "
                   "(%g, %g); the colours are taken for sRGB, as by pbrt-v4",
                   name, (double)c[0][0], (double)c[0][1], (double)c[1][0], (double)c[1][1], (double)c[2][0],
                   (double)c[2][1], (double)c[3][0], (double)c[3][1]);
    return 0;
}

static void convert(const affine_t *m, float rgb[3])
{
    double v[3];
    for (int i = 0; i < 3; ++i) v[i] = fmax((double)rgb[i], 0);
    for (int i = 0; i < 3; ++i) {
        double sum = m->m[i][0] * v[0] + m->m[i][1] * v[1] + m->m[i][2] * v[2];
        rgb[i] = (float)fmin(fmax(sum, 0), (double)FLT_MAX);
    }
}

/* A scene_change_t, whose context is a wanted_t. */
typedef struct {
    pbrt_t *p;
    image_use_t use;
} wanted_t;

static bool change(void *context, const char *name, position_t at, texture_image_t *pixels)
{
    const wanted_t *wanted = context;
    size_t space = space_of(wanted->p, name, at, pixels), count = (size_t)pixels->width * pixels->height;
    if (pixels->channels == 4 && !keeps_alpha(name, pixels)) drop_alpha(pixels);
    if (space == 0) return false;
    if (wanted->use == IMAGE_NUMBERS || pixels->channels < 3) return true;
    affine_t m = pbrt_srgb_from(space, wanted->use == IMAGE_EMITTED);
    for (size_t i = 0; i < count; ++i) convert(&m, pixels->floats + i * pixels->channels);
    return true;
}

result_t pbrt_image(pbrt_t *p, const char *filename, float gamma, image_use_t use, position_t at,
                    const scene_image_t **image)
{
    bool v4 = p->dialect.dialect == DIALECT_V4;
    wanted_t wanted = {.p = p, .use = use};
    const scene_change_t changes = {.use = use, .change = change, .context = &wanted};
    char *path = pbrt_resolve(p, filename);
    result_t result =
        scene_changed_image(p->builder, path, gamma, v4 ? SCENE_ALPHA_APART : SCENE_ALPHA_DROPPED,
                            v4 ? &changes : NULL, at, image);
    free(path);
    return result;
}
