/* colour_spaces: pbrt-v4's ColorSpace directive: what the numbers of an rgb value, or of an image, mean.
 *
 * A space is given by the chromaticities of its primaries and its white; sRGB is reached through XYZ. What is
 * emitted keeps its white's colour, which only ACES's, D60, differs from that of sRGB in; a reflectance of
 * (1, 1, 1) is white in every space, which takes a linear adaptation of the white (Bradford's). The film is
 * always written in linear sRGB. */
#include <string.h>

#include "client/import/files/spectrum.h"
#include "client/import/pbrt/state/arguments.h"
#include "client/import/pbrt/state/colour_spaces.h"

typedef struct {
    const char *name;
    double primaries[3][2]; /* x and y of red, green, blue */
    double white[2];
} colour_space_t;

static const colour_space_t spaces[] = {
    {"srgb", {{0.64, 0.33}, {0.3, 0.6}, {0.15, 0.06}}, {0.3127, 0.3290}},
    {"dci-p3", {{0.68, 0.32}, {0.265, 0.69}, {0.15, 0.06}}, {0.3127, 0.3290}},
    {"rec2020", {{0.708, 0.292}, {0.17, 0.797}, {0.131, 0.046}}, {0.3127, 0.3290}},
    {"aces2065-1", {{0.7347, 0.2653}, {0, 1}, {0.0001, -0.077}}, {0.32168, 0.33767}},
};

result_t pbrt_color_space(pbrt_t *p, position_t at)
{
    TRY(pbrt_read_string(p, 0, "the colour space"));
    for (size_t i = 0; i < ARRAY_LENGTH(spaces); ++i) {
        if (strcmp(p->arguments[0], spaces[i].name) != 0) continue;
        p->now.colour_space = i;
        return result_ok();
    }
    return error_at(at, "unknown colour space \"%.40s\"; srgb, dci-p3, rec2020 and aces2065-1 are known",
                    p->arguments[0]);
}

static void xyz_of(const double xy[2], double xyz[3])
{
    xyz[0] = xy[0] / xy[1];
    xyz[1] = 1;
    xyz[2] = (1 - xy[0] - xy[1]) / xy[1];
}

static void apply(const affine_t *m, double v[3])
{
    double x = v[0], y = v[1], z = v[2];
    for (int i = 0; i < 3; ++i) v[i] = m->m[i][0] * x + m->m[i][1] * y + m->m[i][2] * z;
}

/* XYZ of the space's rgb: (1, 1, 1) is the white with Y = 1. */
static affine_t xyz_from(const colour_space_t *space)
{
    affine_t m = {{{0}}}, inverse;
    double weights[3];
    for (int i = 0; i < 3; ++i) {
        const double *xy = space->primaries[i];
        double column[3] = {xy[0], xy[1], 1 - xy[0] - xy[1]};
        for (int k = 0; k < 3; ++k) m.m[k][i] = column[k];
    }
    xyz_of(space->white, weights);
    affine_invert(&m, &inverse);
    apply(&inverse, weights);
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k) m.m[k][i] *= weights[i];
    return m;
}

/* Takes the XYZ of one white to another's in the space of Bradford's cone responses (Lam 1985). */
static affine_t adaptation(const double from[2], const double to[2])
{
    static const affine_t cones = {
        {{0.8951, 0.2664, -0.1614, 0}, {-0.7502, 1.7135, 0.0367, 0}, {0.0389, -0.0685, 1.0296, 0}}};
    double a[3], b[3];
    affine_t inverse, scaling;
    xyz_of(from, a);
    xyz_of(to, b);
    apply(&cones, a);
    apply(&cones, b);
    double factors[3] = {b[0] / a[0], b[1] / a[1], b[2] / a[2]};
    affine_invert(&cones, &inverse);
    scaling = affine_scaling(factors);
    scaling = affine_multiply(&scaling, &cones);
    return affine_multiply(&inverse, &scaling);
}

/* The chromaticity of CIE daylight (CIE 15) of a colour temperature, below 4000 K that of a black body. The
 * temperature is of the radiation constant of 1931, which has changed since. */
static void daylight(double kelvin, double xy[2])
{
    double t = 1e3 / (kelvin * 1.4388 / 1.4380);
    if (t > 0.25) {
        rgb_t c = spectrum_blackbody(1e3 / t, SPECTRUM_PBRT_V4);
        double v[3] = {(double)c.x, (double)c.y, (double)c.z};
        affine_t xyz = xyz_from(&spaces[0]);
        apply(&xyz, v);
        xy[0] = v[0] / (v[0] + v[1] + v[2]);
        xy[1] = v[1] / (v[0] + v[1] + v[2]);
        return;
    }
    xy[0] = t * 7 > 1 ? 0.244063 + t * (0.09911 + t * (2.9678 - t * 4.6070))
                      : 0.237040 + t * (0.24748 + t * (1.9018 - t * 2.0064));
    xy[1] = -0.275 + xy[0] * (2.870 - 3 * xy[0]);
}

rgb_t pbrt_white_balance(double kelvin)
{
    double from[2], v[3];
    daylight(kelvin, from);
    xyz_of(spaces[0].white, v);
    affine_t balance = adaptation(from, spaces[0].white), srgb = xyz_from(&spaces[0]), from_xyz;
    affine_invert(&srgb, &from_xyz);
    apply(&balance, v);
    apply(&from_xyz, v);
    return vec3((float)fmax(v[0], 0), (float)fmax(v[1], 0), (float)fmax(v[2], 0));
}

/* As close as pbrt-v4 wants it. */
static bool is_close(const float xy[2], const double wanted[2])
{
    for (int i = 0; i < 2; ++i) {
        double found = (double)xy[i];
        if (found != wanted[i] && !(fabs((found - wanted[i]) / wanted[i]) < 1e-3)) return false;
    }
    return true;
}

bool pbrt_find_colour_space(const float xy[4][2], size_t *space)
{
    for (size_t i = 0; i < ARRAY_LENGTH(spaces); ++i) {
        bool all = is_close(xy[3], spaces[i].white);
        for (int k = 0; k < 3; ++k) all = all && is_close(xy[k], spaces[i].primaries[k]);
        if (!all) continue;
        *space = i;
        return true;
    }
    return false;
}

affine_t pbrt_srgb_from(size_t space, bool emitted)
{
    affine_t m = xyz_from(&spaces[space]), srgb = xyz_from(&spaces[0]), from_xyz;
    if (!emitted) {
        affine_t white = adaptation(spaces[space].white, spaces[0].white);
        m = affine_multiply(&white, &m);
    }
    affine_invert(&srgb, &from_xyz);
    return affine_multiply(&from_xyz, &m);
}

rgb_t pbrt_srgb(const pbrt_t *p, rgb_t rgb, bool emitted)
{
    if (p->now.colour_space == 0) return rgb;
    affine_t m = pbrt_srgb_from(p->now.colour_space, emitted);
    double v[3] = {(double)rgb.x, (double)rgb.y, (double)rgb.z};
    apply(&m, v);
    return vec3((float)v[0], (float)v[1], (float)v[2]);
}
