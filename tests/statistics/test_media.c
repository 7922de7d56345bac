/* Participating media against truths in closed form or by quadrature, and the integrators against one another
 * where there are none. Scenes are pbrt text, so that the importer is tested as well. Where a truth is known,
 * the camera is orthographic: it looks from z = 0 along +z at x and y from -1 to 1. */
#include "client/import/import.h"
#include "tests/reference.h"
#include "tests/render_here.h"
#include "tests/scattering.h"
#include "tests/scratch.h"
#include "worker/render/medium/medium.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { SIDE = 32 };

static char *folder;
/* From the command line: the one scene that is to be rendered; NULL for all. */
static const char *only_scene;

/* ---- scenes -------------------------------------------------------------------------------------------- */

#define FILM3 "Film \"image\" \"integer xresolution\" [32] \"integer yresolution\" [32]\n"
#define FILM4 "Film \"rgb\" \"integer xresolution\" [32] \"integer yresolution\" [32]\n"
#define BOX3 "PixelFilter \"box\" \"float xwidth\" [0.5] \"float ywidth\" [0.5]\n"
#define BOX4 "PixelFilter \"box\" \"float xradius\" [0.5] \"float yradius\" [0.5]\n"
#define SOBOL "Sampler \"sobol\"\nIntegrator \"bdpt\"\nWorldBegin\n"
#define AHEAD "LookAt 0 0 0  0 0 1  0 1 0\nCamera \"orthographic\" \"float screenwindow\" [-1 1 -1 1]\n"
/* The camera in empty space, or in the medium. */
#define CLEAR3 AHEAD FILM3 BOX3 SOBOL
#define CLEAR4 AHEAD FILM4 BOX4 SOBOL
#define FOG3 "MediumInterface \"\" \"m\"\n" AHEAD FILM3 BOX3 SOBOL "MediumInterface \"m\" \"m\"\n"
#define FOG4 "MediumInterface \"\" \"m\"\n" AHEAD FILM4 BOX4 SOBOL "MediumInterface \"m\" \"m\"\n"

#define CUBE_OF(point)                                                                                       \
    "Shape \"trianglemesh\" \"integer indices\" [0 2 1 1 2 3 4 5 6 5 7 6 0 1 4 1 5 4 2 6 3 3 6 7 0 4 2 2 4 " \
    "6 1 3 5 3 7 5] \"" point " P\" [-1 -1 -1 1 -1 -1 -1 1 -1 1 1 -1 -1 -1 1 1 -1 1 -1 1 1 1 1 1]\n"
#define CUBE CUBE_OF("point")
/* A body of the medium: the cube, placed and stretched so. */
#define BODY_OF(point, material, place)                                                                      \
    "AttributeBegin\nMediumInterface \"m\" \"\"\n" material place CUBE_OF(point) "AttributeEnd\n"
#define BODY(material, place) BODY_OF("point", material, place)
#define SLAB3(place) BODY("Material \"\"\n", place)
#define SLAB4(place) BODY_OF("point3", "Material \"interface\"\n", place)
#define WALL(z)                                                                                              \
    "Shape \"trianglemesh\" \"integer indices\" [0 1 2 0 2 3] \"point P\" [-9 -9 " z " -9 9 " z " 9 9 " z    \
    " 9 -9 " z "]\n"
/* A black wall that shines. */
#define SHINING(z)                                                                                           \
    "AttributeBegin\nMaterial \"matte\" \"rgb Kd\" [0 0 0]\nAreaLightSource \"diffuse\" \"rgb L\" [1 2 4] "  \
    "\"bool twosided\" \"true\"\n" WALL(z) "AttributeEnd\n"
#define PATCH                                                                                                \
    "Material \"matte\" \"rgb Kd\" [0.5 0.5 0.5]\nShape \"trianglemesh\" \"integer indices\" [0 1 2 0 2 3] " \
    "\"point P\" [-1.2 -1.2 1 -1.2 1.2 1 1.2 1.2 1 1.2 -1.2 1]\n"
/* From the right, above; and along +z. */
#define POINT "LightSource \"point\" \"rgb I\" [3 2 1] \"point from\" [0.4 1.8 0.7]\n"
#define POINT_BEFORE "LightSource \"point\" \"rgb I\" [3 2 1] \"point from\" [0.4 1.8 -0.5]\n"
#define SUN "LightSource \"distant\" \"rgb L\" [1 2 4] \"point from\" [0 0 -1] \"point to\" [0 0 0]\n"
#define SKY "LightSource \"infinite\" \"rgb L\" [1 1 1]\n"

/* A medium of its own for each channel. */
static const double absorption[3] = {0.1, 0.4, 0.7}, scattering[3] = {0.9, 0.3, 0.5}, radiance[3] = {1, 2, 4},
                    intensity[3] = {3, 2, 1};
#define ABSORBS "\"rgb sigma_a\" [0.1 0.4 0.7] "
#define SCATTERS "\"rgb sigma_s\" [0.9 0.3 0.5] "
#define NEITHER_SCATTERS "\"rgb sigma_s\" [0 0 0] "
#define EVEN(more) "MakeNamedMedium \"m\" \"string type\" \"homogeneous\" " more "\n"

/* Densities of a grid over a box. */
typedef struct {
    int cells[3];
    double low[3], high[3];
    bool constant;
} grid_t;

/* Constant where it matters; the second is too long for integrals along rays. */
static const grid_t plain = {{4, 4, 4}, {-20, -20, -6}, {20, 20, 6}, true},
                    plain_long = {{2, 3, 66}, {-30, -20, -6}, {30, 20, 6}, true};
/* Ramps, of a slab that the camera sees, and of one behind it. */
static const grid_t ramp = {{3, 2, 8}, {-1, -1, 0.5}, {1, 1, 2.5}, false},
                    ramp_long = {{3, 2, 66}, {-1, -1, 0.5}, {1, 1, 2.5}, false},
                    behind = {{3, 2, 8}, {-1, -1, -2.5}, {1, 1, -0.5}, false},
                    behind_long = {{3, 2, 66}, {-1, -1, -2.5}, {1, 1, -0.5}, false};

static double cell(const grid_t *grid, int x, int y, int z)
{
    const int *n = grid->cells;
    if (x < 0 || x >= n[0] || y < 0 || y >= n[1] || z < 0 || z >= n[2]) return 0;
    return grid->constant ? 1 : (0.3 + x) * (1.5 - y) * (z + 0.5) / n[2];
}

/* Trilinear between the middles of cells. */
static double density_at(const grid_t *grid, double x, double y, double z)
{
    const double p[3] = {x, y, z};
    double part[3], sum = 0;
    int first[3];
    for (int i = 0; i < 3; i++) {
        double at = (p[i] - grid->low[i]) / (grid->high[i] - grid->low[i]) * grid->cells[i] - 0.5;
        first[i] = (int)floor(at);
        part[i] = at - first[i];
    }
    for (int k = 0; k < 8; k++) {
        int d[3] = {k & 1, k >> 1 & 1, k >> 2};
        double share = 1;
        for (int i = 0; i < 3; i++) share *= d[i] ? part[i] : 1 - part[i];
        sum += share * cell(grid, first[0] + d[0], first[1] + d[1], first[2] + d[2]);
    }
    return sum;
}

/* What the density adds up to along z. */
static double depth_of(const grid_t *grid, double x, double y)
{
    enum { STEPS = 528 };
    double step = (grid->high[2] - grid->low[2]) / STEPS, sum = 0;
    for (int i = 0; i < STEPS; i++) sum += density_at(grid, x, y, grid->low[2] + (i + 0.5) * step) * step;
    return sum;
}

/* The directive that makes it. */
static char *grid_medium(const grid_t *grid, bool v4, const char *more)
{
    const int *n = grid->cells;
    char *text = mem_printf(
        "MakeNamedMedium \"m\" \"string type\" \"%s\" %s \"integer nx\" [%d] \"integer ny\" [%d] "
        "\"integer nz\" [%d] \"%s p0\" [%g %g %g] \"%s p1\" [%g %g %g] \"float density\" [",
        v4 ? "uniformgrid" : "heterogeneous", more, n[0], n[1], n[2], v4 ? "point3" : "point", grid->low[0],
        grid->low[1], grid->low[2], v4 ? "point3" : "point", grid->high[0], grid->high[1], grid->high[2]);
    for (int i = 0; i < n[0] * n[1] * n[2]; i++) {
        char *longer = mem_printf("%s %.9g", text, cell(grid, i % n[0], i / n[0] % n[1], i / (n[0] * n[1])));
        free(text);
        text = longer;
    }
    char *whole = mem_printf("%s]\n", text);
    free(text);
    return whole;
}

/* ---- rendering ----------------------------------------------------------------------------------------- */

static const integrator_t integrators[] = {INTEGRATOR_PATH, INTEGRATOR_BDPT, INTEGRATOR_LIGHT};
enum { PATH, BDPT, LIGHT, INTEGRATORS };

/* The scene of a text; returns its bytes. */
static uint8_t *open_scene(const char *text, scene_blob_t *blob)
{
    char *path = scratch_path(folder, "scene.pbrt");
    scratch_write(path, text, strlen(text));
    uint8_t *bytes;
    uint64_t size;
    result_t made = import_scene_blob(path, NULL, &bytes, &size);
    if (made.code != RESULT_OK) fail_msg("%s", made.message);
    assert_int_equal(blob_open(bytes, size, blob).code, RESULT_OK);
    free(path);
    return bytes;
}

static estimate_image_t render(const char *text, integrator_t integrator, uint32_t spp, int max_depth)
{
    scene_blob_t blob;
    uint8_t *bytes = open_scene(text, &blob);
    job_settings_t settings = blob_default_settings(&blob);
    settings.integrator = integrator;
    settings.spp = spp;
    settings.max_depth = max_depth;
    settings.seed = 21;
    if (integrator == INTEGRATOR_VCM) settings.merge_radius = 0.03;
    film_t *film = render_here(&blob, &settings);
    estimate_image_t image = reference_estimate(film);
    assert_int_equal(film->counts.dropped, 0);
    assert_int_equal(film->counts.overflows, 0);
    film_destroy(&film);
    free(bytes);
    return image;
}

/* Mean of all values and its standard error. */
static double mean_of(const estimate_image_t *image, double *error)
{
    double sum = 0, variance = 0, values = 3.0 * image->width * image->height;
    for (size_t i = 0; i < (size_t)values; i++) sum += image->mean[i], variance += image->variance[i];
    *error = sqrt(variance) / values;
    return sum / values;
}

/* `most_error`: of the mean, for the test to tell anything. */
static bool agree(const char *what, const char *who, const estimate_image_t *image,
                  const estimate_image_t *reference, double most_error)
{
    agreement_t agreement;
    agreement_limits_t limits = agreement_default_limits();
    limits.max_rms = 1.5; /* of 16 blocks, whose channels go together */
    agreement_measure(image, reference, &agreement);
    double error, mean = mean_of(image, &error);
    bool sharp = mean > 0 && error < most_error * mean, holds = agreement_holds(&agreement, &limits) && sharp;
    print_message("%-28s %-5s mean %.4f, ratio %.4f %.4f %.4f, error %.4f, z mean %.1f %.1f %.1f rms %.2f "
                  "max %.2f%s%s\n",
                  what, who, mean, agreement.mean_ratio[0], agreement.mean_ratio[1], agreement.mean_ratio[2],
                  error / mean, agreement.mean_z[0], agreement.mean_z[1], agreement.mean_z[2],
                  agreement.rms_z, agreement.max_z, holds ? "" : "  <-- differs",
                  sharp ? "" : " (too noisy)");
    agreement_free(&agreement);
    return holds;
}

/* ---- truths -------------------------------------------------------------------------------------------- */

/* What the eye ray at x and y brings of a channel. */
typedef double (*truth_t)(double x, double y, int channel);

static estimate_image_t image_of(truth_t truth)
{
    enum { PARTS = 4 };
    estimate_image_t image = {SIDE, SIDE, mem_zalloc(3 * SIDE * SIDE, sizeof(double)),
                              mem_zalloc(3 * SIDE * SIDE, sizeof(double))};
    for (int i = 0; i < SIDE * SIDE * PARTS * PARTS; i++) {
        int column = i % (SIDE * PARTS), row = i / (SIDE * PARTS);
        double x = 2 * (column + 0.5) / (SIDE * PARTS) - 1, y = 1 - 2 * (row + 0.5) / (SIDE * PARTS);
        double *pixel = image.mean + 3 * (row / PARTS * SIDE + column / PARTS);
        for (int c = 0; c < 3; c++) pixel[c] += truth(x, y, c) / (PARTS * PARTS);
    }
    return image;
}

static bool is_v4(const char *text)
{
    return strstr(text, "Film \"rgb\"") != NULL;
}

/* Holds what the integrators make of a scene to its truth, but where their samples are 0. */
static bool check_truth(const char *name, const char *medium, const char *text, int max_depth, truth_t truth,
                        const uint32_t samples[INTEGRATORS])
{
    if (only_scene != NULL && strcmp(only_scene, name) != 0) return true;
    char *whole = mem_printf("%s%s%s", medium, text, is_v4(text) ? "" : "WorldEnd\n");
    estimate_image_t expected = image_of(truth);
    bool holds = true;
    for (int k = 0; k < INTEGRATORS; k++) {
        if (samples[k] == 0) continue;
        estimate_image_t image = render(whole, integrators[k], samples[k], max_depth);
        holds = agree(name, integrator_name(integrators[k]), &image, &expected, 0.0085) && holds;
        estimate_image_free(&image);
    }
    estimate_image_free(&expected);
    free(whole);
    return holds;
}

static bool check_grid(const char *name, const grid_t *grid, const char *more, const char *text,
                       int max_depth, truth_t truth, const uint32_t samples[INTEGRATORS])
{
    char *medium = grid_medium(grid, is_v4(text), more);
    bool holds = check_truth(name, medium, text, max_depth, truth, samples);
    free(medium);
    return holds;
}

/* ---- what is left of light ----------------------------------------------------------------------------- */

static double extinction(int c)
{
    return absorption[c] + scattering[c];
}

static double absorbed_over_2(double x, double y, int c)
{
    (void)x, (void)y;
    return exp(-2 * absorption[c]) * radiance[c];
}

static double lost_over_2(double x, double y, int c)
{
    (void)x, (void)y;
    return exp(-2 * extinction(c)) * radiance[c];
}

static double lost_before_wall(double x, double y, int c)
{
    return 0.5 / M_PI * lost_over_2(x, y, c);
}

static double lost_before_leaf(double x, double y, int c)
{
    return 0.5 * lost_before_wall(x, y, c);
}

/* A wall that shines through fog, or through a slab; and a wall that the sun lights through a slab. Where
 * light is scattered, paths are so short that none of it comes back. */
static void slabs_dim_what_is_behind(void **state)
{
    (void)state;
    static const uint32_t few[] = {16, 16, 16}, more[] = {32, 32, 128}, most[] = {96, 96, 256};
#define SLAB SLAB3("Translate 0 0 1.5\nScale 9 9 1\n")
#define SHADED SLAB3("Translate 0 0 -1.5\nScale 1.4 1.4 1\n")
#define SHADE CLEAR3 SUN PATCH SHADED
#define SLICE(z) SLAB3("Translate 0 0 " z "\nScale 1.4 1.4 0.1\n")
#define SLICES(tenth)                                                                                        \
    SLICE("-0." tenth) SLICE("-1." tenth) SLICE("-2." tenth) SLICE("-3." tenth) SLICE("-4." tenth)
    bool holds = check_truth("fog that absorbs", EVEN(ABSORBS NEITHER_SCATTERS), FOG3 SHINING("2"), 3,
                             absorbed_over_2, few);
    holds = check_truth("slab that absorbs", EVEN(ABSORBS NEITHER_SCATTERS), CLEAR3 SHINING("3") SLAB, 3,
                        absorbed_over_2, few) &&
            holds;
    holds = check_truth("fog", EVEN(ABSORBS SCATTERS), FOG3 SHINING("2"), 0, lost_over_2, more) && holds;
    holds =
        check_truth("slab", EVEN(ABSORBS SCATTERS), CLEAR3 SHINING("3") SLAB, 0, lost_over_2, more) && holds;
    holds = check_grid("slab of a grid", &plain, ABSORBS SCATTERS, CLEAR3 SHINING("3") SLAB, 0, lost_over_2,
                       more) &&
            holds;
    holds = check_grid("slab of a long grid", &plain_long, ABSORBS SCATTERS, CLEAR3 SHINING("3") SLAB, 0,
                       lost_over_2, most) &&
            holds;
    holds = check_truth("shade", EVEN(ABSORBS SCATTERS), SHADE, 1, lost_before_wall, most) && holds;
    holds = check_truth("shade of nine in one", EVEN(ABSORBS SCATTERS),
                        SHADE SHADED SHADED SHADED SHADED SHADED SHADED SHADED SHADED, 1, lost_before_wall,
                        most) &&
            holds;
    holds = check_truth("shade of slices", EVEN(ABSORBS SCATTERS), CLEAR3 SUN PATCH SLICES("3") SLICES("7"),
                        1, lost_before_wall, most) &&
            holds;
    holds =
        check_grid("shade of a grid", &plain, ABSORBS SCATTERS, SHADE, 1, lost_before_wall, most) && holds;
    holds =
        check_grid("shade of a long grid", &plain_long, ABSORBS SCATTERS, SHADE, 1, lost_before_wall, most) &&
        holds;
    assert_true(holds);
}

/* A leaf that lets half of the light through is no border of a medium, and hides none: it stands before a
   placed slab, or in it. */
static void leaves_hide_no_borders(void **state)
{
    (void)state;
    static const uint32_t samples[] = {256, 256, 0};
#define SUN4 "LightSource \"distant\" \"rgb L\" [1 2 4] \"point3 from\" [0 0 -1] \"point3 to\" [0 0 0]\n"
#define GREY4 "Material \"diffuse\" \"rgb reflectance\" [0.5 0.5 0.5]\n"
#define SQUARE4(side, z, more)                                                                               \
    "Shape \"trianglemesh\" \"integer indices\" [0 1 2 0 2 3] \"point3 P\" [-" side " -" side " " z          \
    " -" side " " side " " z " " side " " side " " z " " side " -" side " " z "] " more "\n"
#define WALL_AND_LEAF4(z) GREY4 SQUARE4("1.2", "1", "") SQUARE4("9", z, "\"float alpha\" [0.5]")
#define PLACED(thing) "ObjectBegin \"thing\"\n" thing "ObjectEnd\nObjectInstance \"thing\"\n"
#define PLACED_SLAB4 PLACED(SLAB4("Translate 0 0 -1.5\nScale 2 2 1\n"))
    bool holds = check_truth("leaf before a slab", EVEN(ABSORBS SCATTERS),
                             CLEAR4 SUN4 WALL_AND_LEAF4("-0.2") PLACED_SLAB4, 1, lost_before_leaf, samples);
    holds = check_truth("leaf in a slab", EVEN(ABSORBS SCATTERS),
                        CLEAR4 SUN4 WALL_AND_LEAF4("-1.5") PLACED_SLAB4, 1, lost_before_leaf, samples) &&
            holds;
    assert_true(holds);
}

static double lost_in_ramp(double x, double y, int c)
{
    return exp(-extinction(c) * depth_of(&ramp, x, y)) * radiance[c];
}

static double lost_in_long_ramp(double x, double y, int c)
{
    return exp(-extinction(c) * depth_of(&ramp_long, x, y)) * radiance[c];
}

static double shade_of_ramp(double x, double y, int c)
{
    return 0.5 / M_PI * exp(-extinction(c) * depth_of(&behind, x, y)) * radiance[c];
}

static double shade_of_long_ramp(double x, double y, int c)
{
    return 0.5 / M_PI * exp(-extinction(c) * depth_of(&behind_long, x, y)) * radiance[c];
}

static void densities_are_interpolated(void **state)
{
    (void)state;
    static const uint32_t samples[] = {128, 128, 128}, more[] = {128, 128, 512};
#define RAMP CLEAR3 SHINING("3") SLAB3("Translate 0 0 1.5\n")
#define RAMP_SHADE CLEAR3 SUN PATCH SLAB3("Translate 0 0 -1.5\n")
    bool holds = check_grid("ramp", &ramp, ABSORBS SCATTERS, RAMP, 0, lost_in_ramp, samples);
    holds =
        check_grid("long ramp", &ramp_long, ABSORBS SCATTERS, RAMP, 0, lost_in_long_ramp, samples) && holds;
    holds =
        check_grid("shade of a ramp", &behind, ABSORBS SCATTERS, RAMP_SHADE, 1, shade_of_ramp, more) && holds;
    holds = check_grid("shade of a long ramp", &behind_long, ABSORBS SCATTERS, RAMP_SHADE, 1,
                       shade_of_long_ramp, more) &&
            holds;
    assert_true(holds);
}

/* ---- light that is scattered once ---------------------------------------------------------------------- */

static double phase(double g, double cosine)
{
    double wide = 1 + g * g - 2 * g * cosine;
    return (1 - g * g) / (4 * M_PI * wide * sqrt(wide));
}

/* Of a point light at (0.4, 1.8, `height`), at a place of the eye ray; `through`: the share of the way from
 * the light that lies in the medium, where `seen` of the eye ray does. */
static double scattered(double x, double y, double z, double height, double g, double seen, double through,
                        int c)
{
    double dx = x - 0.4, dy = y - 1.8, dz = z - height, r = sqrt(dx * dx + dy * dy + dz * dz);
    double cosine = -dz / r; /* between the ways of light before, away from the point, and after, along -z */
    return scattering[c] * phase(g, cosine) * intensity[c] / (r * r) *
           exp(-extinction(c) * (seen + through * r));
}

static double scattered_in_fog(double x, double y, double g, int c)
{
    enum { STEPS = 400 };
    double sum = 0;
    for (int i = 0; i < STEPS; i++) { /* z = w / (1 - w) */
        double w = (i + 0.5) / STEPS, z = w / (1 - w);
        sum += scattered(x, y, z, 0.7, g, z, 1, c) / ((1 - w) * (1 - w) * STEPS);
    }
    return sum;
}

/* In a slab between z = 0.5 and 2.5, which the light, at z = -0.5, shines into. */
static double scattered_in_slab(double x, double y, double g, int c)
{
    enum { STEPS = 200 };
    double sum = 0;
    for (int i = 0; i < STEPS; i++) {
        double depth = 2 * (i + 0.5) / STEPS;
        sum += scattered(x, y, 0.5 + depth, -0.5, g, depth, depth / (depth + 1), c) * 2 / STEPS;
    }
    return sum;
}

static double fog_evenly(double x, double y, int c)
{
    return scattered_in_fog(x, y, 0, c);
}

static double fog_forwards(double x, double y, int c)
{
    return scattered_in_fog(x, y, 0.6, c);
}

static double slab_evenly(double x, double y, int c)
{
    return scattered_in_slab(x, y, 0, c);
}

static double slab_backwards(double x, double y, int c)
{
    return scattered_in_slab(x, y, -0.5, c);
}

static void light_is_scattered_once(void **state)
{
    (void)state;
    static const uint32_t samples[] = {32, 32, 512};
#define LIT_SLAB CLEAR3 POINT_BEFORE SLAB3("Translate 0 0 1.5\nScale 90 90 1\n")
    bool holds = check_truth("point in fog", EVEN(ABSORBS SCATTERS), FOG3 POINT, 1, fog_evenly, samples);
    holds = check_truth("point in fog, g 0.6", EVEN(ABSORBS SCATTERS "\"float g\" [0.6]"), FOG3 POINT, 1,
                        fog_forwards, samples) &&
            holds;
    holds = check_truth("lit slab", EVEN(ABSORBS SCATTERS), LIT_SLAB, 1, slab_evenly, samples) && holds;
    holds = check_grid("lit slab of a grid", &plain, ABSORBS SCATTERS "\"float g\" [-0.5]",
                       CLEAR3 POINT_BEFORE SLAB3("Translate 0 0 1.5\nScale 14 14 1\n"), 1, slab_backwards,
                       samples) &&
            holds;
    holds = check_grid("lit slab of a long grid", &plain_long, ABSORBS SCATTERS "\"float g\" [-0.5]",
                       CLEAR3 POINT_BEFORE SLAB3("Translate 0 0 1.5\nScale 13 13 1\n"), 1, slab_backwards,
                       samples) &&
            holds;
    assert_true(holds);
}

/* ---- furnaces ------------------------------------------------------------------------------------------ */

static double one(double x, double y, int c)
{
    (void)x, (void)y, (void)c;
    return 1;
}

/* A medium that only scatters vanishes before a sky of 1, in whatever body that loses no light. */
static void white_media_vanish(void **state)
{
    (void)state;
    static const uint32_t samples[] = {32, 24, 128}, unseen[] = {32, 24, 0};
#define WHITE "\"rgb sigma_a\" [0 0 0] \"rgb sigma_s\" [0.5 1 2] \"float g\" [0.3]"
#define CLOUD BODY("Material \"\"\n", "Translate 0 0 2\nRotate 30 1 1 0\nScale 0.5 0.4 0.6\n")
#define GLASS(roughness)                                                                                     \
    BODY("Material \"glass\" \"float eta\" [1.4] \"float uroughness\" [" roughness                           \
         "] \"float vroughness\" [" roughness "]\n",                                                         \
         "Translate 0 0 2\nRotate 30 1 1 0\nScale 0.5 0.4 0.6\n")
    static const grid_t uneven = {{3, 2, 4}, {-1, -1, 1}, {1, 1, 3}, false},
                        uneven_long = {{3, 2, 66}, {-1, -1, 1}, {1, 1, 3}, false};
    bool holds = check_truth("white body", EVEN(WHITE), CLEAR3 SKY CLOUD, 100, one, samples);
    holds = check_grid("white grid", &uneven, WHITE, CLEAR3 SKY CLOUD, 100, one, samples) && holds;
    holds = check_grid("white long grid", &uneven_long, WHITE, CLEAR3 SKY CLOUD, 100, one, samples) && holds;
    holds = check_truth("white glass", EVEN(WHITE), CLEAR3 SKY GLASS("0"), 100, one, unseen) && holds;
    assert_true(holds);
}

/* ---- emission ------------------------------------------------------------------------------------------ */

static double glow(double depth, double scatters, int c)
{
    double share = absorption[c] / (absorption[c] + scatters * scattering[c]);
    return share * (1 - exp(-depth * (absorption[c] + scatters * scattering[c]))) * radiance[c];
}

static double glow_over_2(double x, double y, int c)
{
    (void)x, (void)y;
    return glow(2, 0, c);
}

static double scattered_glow_over_2(double x, double y, int c)
{
    (void)x, (void)y;
    return glow(2, 1, c);
}

static double glow_of_ramp(double x, double y, int c)
{
    return glow(depth_of(&ramp, x, y), 0, c);
}

static double glow_of_long_ramp(double x, double y, int c)
{
    return glow(depth_of(&ramp_long, x, y), 1, c);
}

static void media_glow(void **state)
{
    (void)state;
    static const uint32_t samples[] = {32, 32, 32};
#define GLOWS "\"rgb Le\" [1 2 4]"
#define BLACK4                                                                                               \
    "Material \"diffuse\" \"rgb reflectance\" [0 0 0]\nShape \"trianglemesh\" \"integer indices\" [0 1 2 0 " \
    "2 3] \"point3 P\" [-9 -9 2 -9 9 2 9 9 2 9 -9 2]\n"
/* What glows behind it is too far away. */
#define WAX4                                                                                                 \
    "AttributeBegin\nMaterial \"subsurface\" \"rgb sigma_a\" [0.1 0.1 0.1] \"rgb sigma_s\" [0.5 0.5 0.5] "   \
    "\"float eta\" [1.3]\nTranslate 0 0 3\nScale 9 9 1\n" CUBE_OF("point3") "AttributeEnd\n"
    bool holds = check_truth("glow of fog", EVEN(ABSORBS NEITHER_SCATTERS GLOWS), FOG4 BLACK4, 3, glow_over_2,
                             samples);
    holds = check_truth("glow before a body", EVEN(ABSORBS NEITHER_SCATTERS GLOWS), FOG4 WAX4, 0, glow_over_2,
                        samples) &&
            holds;
    holds =
        check_truth("glow of a slab", EVEN(ABSORBS SCATTERS GLOWS),
                    CLEAR4 SLAB4("Translate 0 0 1.5\nScale 9 9 1\n"), 0, scattered_glow_over_2, samples) &&
        holds;
    holds = check_grid("glow of a ramp", &ramp, ABSORBS NEITHER_SCATTERS GLOWS,
                       CLEAR4 SLAB4("Translate 0 0 1.5\n"), 3, glow_of_ramp, samples) &&
            holds;
    holds = check_grid("glow of a long ramp", &ramp_long, ABSORBS SCATTERS GLOWS,
                       CLEAR4 SLAB4("Translate 0 0 1.5\n"), 0, glow_of_long_ramp, samples) &&
            holds;
    assert_true(holds);
}

/* What is well stratified is worth more there. */
static void glow_leaves_the_first_number_to_the_distance(void **state)
{
    (void)state;
    char *medium = grid_medium(&ramp, true, ABSORBS SCATTERS GLOWS);
    char *text = mem_printf("%s%s", medium, CLEAR4 SLAB4("Translate 0 0 1.5\n"));
    scene_blob_t blob;
    uint8_t *bytes = open_scene(text, &blob);
    media_t *media = media_new(&blob, false);
    media_numbers_t numbers = {.first = 0.3f, .key = 1};
    assert_true(media_emission(media, 1, vec3(0, 0, 0), vec3(0, 0, 1), 5, &numbers).x > 0);
    assert_true(numbers.first == 0.3f && numbers.key != 1);
    media_destroy(&media);
    free(bytes);
    free(text);
    free(medium);
}

/* ---- one integrator and another ------------------------------------------------------------------------ */

#define LOOK "LookAt 0 1.6 -5  0 1 0  0 1 0\n"
#define PERSPECTIVE LOOK "Camera \"perspective\" \"float fov\" [40]\n"
#define ROOM_HEAD PERSPECTIVE FILM3 BOX3 SOBOL
#define QUAD(p) "Shape \"trianglemesh\" \"integer indices\" [0 1 2 0 2 3] \"point P\" [" p "]\n"
#define STAGE                                                                                                \
    "Material \"matte\" \"rgb Kd\" [0.6 0.6 0.55]\n" QUAD("-2 0 -2  2 0 -2  2 0 2  -2 0 2")                  \
        QUAD("-2 0 2  2 0 2  2 3 2  -2 3 2") "Material \"matte\" \"rgb Kd\" [0.7 0.2 0.2]\n" QUAD(           \
            "-2 0 -2  -2 0 2  -2 3 2  -2 3 -2")
#define LAMP                                                                                                 \
    "AttributeBegin\nAreaLightSource \"diffuse\" \"rgb L\" [12 11 9]\n" QUAD(                                \
        "-0.5 2.9 -0.5  0.5 2.9 -0.5  0.5 2.9 0.5  -0.5 2.9 0.5") "AttributeEnd\n"
#define BALL(place, radius)                                                                                  \
    "AttributeBegin\n" place "Shape \"sphere\" \"float radius\" [" radius "]\nAttributeEnd\n"
#define LAMP_BALL                                                                                            \
    "AttributeBegin\nMaterial \"matte\" \"rgb Kd\" [0.5 0.5 0.5]\nTranslate 0.5 1.4 0\nAreaLightSource "     \
    "\"diffuse\" \"rgb L\" [20 15 12]\nShape \"sphere\" \"float radius\" [0.2]\nAttributeEnd\n"
#define COLOURED(name, scale)                                                                                \
    "MakeNamedMedium \"" name "\" \"string type\" \"homogeneous\" \"rgb sigma_a\" [0.05 0.2 0.4] \"rgb "     \
    "sigma_s\" [1 2 0.5] \"float g\" [0.4] \"float scale\" [" scale "]\n"
#define INSIDE(inner, outer) "MediumInterface \"" inner "\" \"" outer "\"\n"

typedef struct {
    const char *name, *text;
} case_t;

static const case_t cases[] = {
    {"body", ROOM_HEAD COLOURED("m", "2") STAGE LAMP "Material \"\"\n" INSIDE("m", "")
                 BALL("Translate 0.5 0.8 0\n", "0.8") "WorldEnd\n"},
    {"rough body", ROOM_HEAD COLOURED("m", "2") STAGE LAMP
     "Material \"glass\" \"float uroughness\" [0.3] \"float vroughness\" [0.3] \"bool remaproughness\" "
     "\"false\" \"float eta\" [1.3]\n" INSIDE("m", "") BALL("Translate 0.5 0.8 0\n", "0.7") "WorldEnd\n"},
    {"nested bodies", ROOM_HEAD COLOURED("m", "0.5") COLOURED("n", "4") STAGE LAMP
     "Material \"\"\n" INSIDE("m", "") BALL("Translate 0 1 0\nScale 1.2 0.9 1\n", "1") INSIDE("n", "m")
         BALL("Translate 0.3 1 0\n", "0.5") "WorldEnd\n"},
    {"instances",
     ROOM_HEAD COLOURED("m", "2") STAGE LAMP "ObjectBegin \"thing\"\nMaterial \"\"\n" INSIDE("m", "") CUBE
     "ObjectEnd\nAttributeBegin\nTranslate -0.8 0.6 0\nRotate 30 1 1 0\nScale 0.4 0.3 0.5\nObjectInstance "
     "\"thing\"\nAttributeEnd\nAttributeBegin\nTranslate 0.8 1.2 0\nScale -0.5 0.5 0.4\nObjectInstance "
     "\"thing\"\nAttributeEnd\nWorldEnd\n"},
    {"light in a body", ROOM_HEAD COLOURED("m", "2") STAGE "Material \"\"\n" INSIDE("m", "")
                            BALL("Translate 0.3 1.2 0\n", "0.9") INSIDE("", "m") LAMP_BALL "WorldEnd\n"},
    {"light that does not know of fog", ROOM_HEAD COLOURED("m", "0.3") STAGE LAMP
     "Material \"\"\n" INSIDE("m", "") BALL("Translate 0 1 0\n", "3.5") "WorldEnd\n"},
    {"light that does not know of full glass", ROOM_HEAD COLOURED("m", "1") STAGE
     "Material \"glass\" \"float uroughness\" [0.3] \"float vroughness\" [0.3] \"bool remaproughness\" "
     "\"false\" \"float eta\" [1.3]\n" INSIDE("m", "") BALL("Translate 0.5 1.4 0\n", "0.9") INSIDE("", "")
         LAMP_BALL "WorldEnd\n"},
    {"light that does not know of fog without an end",
     COLOURED("m", "0.2") INSIDE("", "m") ROOM_HEAD INSIDE("", "") STAGE LAMP "WorldEnd\n"},
    {"orthographic in fog", COLOURED("m", "0.2") INSIDE("", "m") LOOK
     "Camera \"orthographic\" \"float screenwindow\" [-1.8 1.8 -1 2.6]\n" FILM3 BOX3 SOBOL INSIDE("m", "m")
         STAGE LAMP
     "Material \"plastic\" \"float roughness\" [0.2]\n" BALL("Translate 0.7 0.5 0.2\n", "0.5") "WorldEnd\n"},
    {"sky and spot", ROOM_HEAD COLOURED("m", "2") STAGE SKY
     "LightSource \"spot\" \"rgb I\" [20 18 19] \"point from\" [-1 2.5 -1.5] \"point to\" [0.4 0.6 0.2] "
     "\"float coneangle\" [30] \"float conedeltaangle\" [15]\nMaterial \"\"\n" INSIDE("m", "")
         BALL("Translate 0.5 0.8 0\n", "0.7") "WorldEnd\n"},
    {"smoke", ROOM_HEAD
     "MakeNamedMedium \"m\" \"string type\" \"heterogeneous\" \"rgb sigma_a\" [0.3 0.6 0.9] \"rgb "
     "sigma_s\" [3 2.7 2.4] \"point p0\" [-1 0 -1] \"point p1\" [1 2 1] \"integer nx\" [2] "
     "\"integer ny\" [2] \"integer nz\" [2] \"float density\" [0.2 1 2 0 0.5 3 1 0.1]\n" STAGE LAMP
     "Material \"\"\n" INSIDE("m", "") "AttributeBegin\nTranslate 0 1 0\n" CUBE "AttributeEnd\nWorldEnd\n"},
};

enum { MAX_DEPTH = 4 };

static bool check(const case_t *c)
{
    estimate_image_t path = render(c->text, INTEGRATOR_PATH, 192, MAX_DEPTH);
    static const integrator_t others[] = {INTEGRATOR_BDPT, INTEGRATOR_LIGHT, INTEGRATOR_VCM};
    static const uint32_t samples[] = {192, 128, 16};
    bool holds = true;
    for (size_t k = 0; k < ARRAY_LENGTH(others); k++) {
        estimate_image_t image = render(c->text, others[k], samples[k], MAX_DEPTH);
        holds = agree(c->name, integrator_name(others[k]), &image, &path, 0.028) && holds;
        estimate_image_free(&image);
    }
    estimate_image_free(&path);
    return holds;
}

static void integrators_agree(void **state)
{
    (void)state;
    int differing = 0;
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++)
        if (only_scene == NULL || strcmp(only_scene, cases[i].name) == 0) differing += !check(&cases[i]);
    assert_int_equal(differing, 0);
}

/* A body that is met first has one flight, in which fog behind it has all its light: as much as where the
 * same medium is no body, and has two. */
static void fog_in_a_body_has_all_its_light(void **state)
{
    (void)state;
#define THIN "\"rgb sigma_a\" [2 2 2] \"rgb sigma_s\" [3.5 3.5 3.5]"
#define SCREEN "Material \"matte\" \"rgb Kd\" [0 0 0]\n" QUAD("-0.1 0.8 0  0.7 0.8 0  0.7 1.6 0  -0.1 1.6 0")
#define HIDDEN_LAMP                                                                                          \
    SCREEN "AttributeBegin\nTranslate 0.3 1.2 0.2\nAreaLightSource \"diffuse\" \"rgb L\" [20 20 20]\n"       \
           "Shape \"sphere\" \"float radius\" [0.2]\nAttributeEnd\n"
#define FOG_IN_BALL                                                                                          \
    BALL("Translate 0.3 1.2 0\n", "1.2")                                                                     \
    "Material \"\"\n" INSIDE("m", "n") BALL("Translate 0.3 1.2 0\n", "1") INSIDE("", "m") HIDDEN_LAMP        \
        "WorldEnd\n"
#define MEDIA COLOURED("m", "0.5") "MakeNamedMedium \"n\" \"string type\" \"homogeneous\" " THIN "\n"
    enum { DEEP = 20 };
    static const char body[] =
        ROOM_HEAD MEDIA "Material \"subsurface\" " THIN " \"float eta\" [1.0001]\n" FOG_IN_BALL;
    static const char none[] = ROOM_HEAD MEDIA "Material \"\"\n" INSIDE("n", "") FOG_IN_BALL;
    estimate_image_t a = render(body, INTEGRATOR_PATH, 512, DEEP),
                     b = render(none, INTEGRATOR_PATH, 512, DEEP);
    bool holds = agree("fog in a body", "path", &a, &b, 0.02);
    estimate_image_free(&a);
    estimate_image_free(&b);
    assert_true(holds);
}

/* ---- phase functions ----------------------------------------------------------------------------------- */

/* All directions in rings about wo: what is scattered in sum, and the mean cosine between the ways before and
 * after. */
static void check_moments(const bsdf_t *bsdf, vec3_t wo, double g)
{
    enum { RINGS = 20000 };
    double sum = 0, mean = 0, ring = 4 * M_PI / RINGS;
    for (int i = 0; i < RINGS; i++) {
        double z = 2 * (i + 0.5) / RINGS - 1;
        float r = (float)sqrt(1 - z * z), phi = (float)i;
        vec3_t across = v_add(v_scale(bsdf->s, r * cosf(phi)), v_scale(bsdf->t, r * sinf(phi)));
        bsdf_value_t value;
        assert_true(bsdf_eval(bsdf, wo, v_mad(across, (float)z, wo), TRANSPORT_RADIANCE, &value));
        assert_true(value.f.y == value.pdf && value.pdf == value.pdf_rev);
        assert_true(fabs((double)value.pdf - phase(g, -z)) < 1e-3 * phase(g, -z) + 1e-5);
        sum += (double)value.pdf * ring;
        mean -= (double)value.pdf * ring * z;
    }
    assert_true(fabs(sum - 1) < 1e-3);
    assert_true(fabs(mean - g) < 1e-3);
}

/* Samples say what evaluation says of their directions, and lose nothing. */
static void check_samples(const bsdf_t *bsdf, vec3_t wo)
{
    for (uint32_t i = 0; i < 1000; i++) {
        sampler_t sampler = sampler_new(SAMPLER_INDEPENDENT, 3, 0, i);
        bsdf_sample_t sample;
        bsdf_value_t value;
        assert_true(bsdf_sample(bsdf, wo, sampler_2d(&sampler), 0.5f, TRANSPORT_IMPORTANCE, &sample));
        assert_true(bsdf_eval(bsdf, wo, sample.wi, TRANSPORT_IMPORTANCE, &value));
        assert_false(sample.specular);
        assert_true(fabsf(v_length(sample.wi) - 1) < 1e-5f);
        assert_true(fabsf(sample.pdf / value.pdf - 1) < 0.01f && sample.pdf == sample.pdf_rev);
        assert_true(sample.weight.x == 1 && sample.weight.y == 1 && sample.weight.z == 1);
    }
}

static void phases_are_densities(void **state)
{
    (void)state;
    static const float gs[] = {-0.9f, -0.5f, -0.01f, 0, 0.0005f, 0.3f, 0.7f, 0.9f};
    const vec3_t wo = v_normalize(vec3(0.3f, -0.5f, 0.6f));
    for (size_t i = 0; i < ARRAY_LENGTH(gs); i++) {
        blob_medium_t record = {.scattering = {1, 1, 1}, .g = gs[i]};
        scene_blob_t blob = {.media = &record, .counts[BLOB_SECTION_MEDIA] = 1};
        media_t *media = media_new(&blob, false);
        bsdf_t bsdf;
        media_bsdf(media, 1, wo, &bsdf);
        check_moments(&bsdf, wo, (double)gs[i]);
        check_samples(&bsdf, wo);
        scattering_check_draws(&bsdf, wo);
        media_destroy(&media);
        assert_null(media);
    }
}

static int begin(void **state)
{
    (void)state;
    folder = scratch_new();
    return 0;
}

static int end(void **state)
{
    (void)state;
    scratch_destroy(&folder);
    return 0;
}

/* So dense in one cell that tentative collisions in the empty ones beside it do not move a ray any more. */
static void every_flight_ends(void **state)
{
    (void)state;
    static const char text[] =
        "LookAt 10 0.5 0.5  0 0.5 0.5  0 1 0\nCamera \"perspective\" \"float fov\" [5]\n"
        "Film \"rgb\" \"integer xresolution\" [2] \"integer yresolution\" [2]\nWorldBegin\n"
        "LightSource \"infinite\"\n"
        "MakeNamedMedium \"c\" \"string type\" \"uniformgrid\" \"integer nx\" [4] \"integer ny\" [1] "
        "\"integer nz\" [1] \"float density\" [1e9 0 0 0]\n"
        "MediumInterface \"c\" \"\"\nMaterial \"interface\"\nShape \"sphere\" \"float radius\" [2]\n";
    estimate_image_t image = render(text, INTEGRATOR_PATH, 1, 2);
    estimate_image_free(&image);
}

int main(int argc, char **argv)
{
    only_scene = argc > 1 ? argv[1] : NULL;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(slabs_dim_what_is_behind),
        cmocka_unit_test(leaves_hide_no_borders),
        cmocka_unit_test(densities_are_interpolated),
        cmocka_unit_test(light_is_scattered_once),
        cmocka_unit_test(white_media_vanish),
        cmocka_unit_test(media_glow),
        cmocka_unit_test(glow_leaves_the_first_number_to_the_distance),
        cmocka_unit_test(phases_are_densities),
        cmocka_unit_test(integrators_agree),
        cmocka_unit_test(fog_in_a_body_has_all_its_light),
        cmocka_unit_test(every_flight_ends),
    };
    return cmocka_run_group_tests(tests, begin, end);
}
