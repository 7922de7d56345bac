/* Media that vary, of every sort that the importer knows: what media_scatter, media_transmittance and
 * media_emission make of rays, against quadrature over what the scene's text says, in double precision. */
#include "client/import/import.h"
#include "common/scene/scene_blob.h"
#include "tests/nanovdb_pack.h"
#include "tests/scratch.h"
#include "worker/render/medium/cloud.h"
#include "worker/render/medium/medium.h"

#include "common/base.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { SAMPLES = 12000, STEPS = 6000 };

static char *folder;

/* ---- what the media are ----------------------------------------------------------------------------------
 */

/* The coefficients at a point, and what is emitted there per unit length. */
typedef struct {
    double absorption[3], scattering[3], emission[3];
} truth_t;
typedef void (*truth_at_t)(const double p[3], truth_t *truth);

static const double absorption[3] = {0.2, 0.5, 0.8}, scattering[3] = {1.5, 0.6, 0.9};
#define COEFFICIENTS "\"rgb sigma_a\" [0.2 0.5 0.8] \"rgb sigma_s\" [1.5 0.6 0.9] "

/* All lies in the box from -1 to 1, 2 and 1.5. */
static const double low[3] = {-1, -1, -1}, high[3] = {1, 2, 1.5};
#define BOX "\"point3 p0\" [-1 -1 -1] \"point3 p1\" [1 2 1.5] "

static double clamp(double x, double from, double to)
{
    return x < from ? from : x > to ? to : x;
}

/* The numbers of cells, which are 0 at some. */
static float cell(const void *context, int x, int y, int z)
{
    const int *n = context;
    if (x < 0 || y < 0 || z < 0 || x >= n[0] || y >= n[1] || z >= n[2]) return 0;
    double wave = sin(0.9 * x + 0.4) * cos(0.7 * y) + sin(1.3 * z);
    return (x / 5 + y / 5 + z / 9) % 3 == 0 ? 0 : (float)clamp(1.2 * wave, 0, 2);
}

/* Trilinear between numbers that stand at whole places. */
static double between(const int n[3], const double place[3], float (*number)(const void *, int, int, int))
{
    int first[3];
    double part[3], sum = 0;
    for (int i = 0; i < 3; i++) {
        first[i] = (int)floor(place[i]);
        part[i] = place[i] - first[i];
    }
    for (int k = 0; k < 8; k++) {
        const int d[3] = {k & 1, k >> 1 & 1, k >> 2};
        double share = 1;
        for (int i = 0; i < 3; i++) share *= d[i] ? part[i] : 1 - part[i];
        sum += share * (double)number(n, first[0] + d[0], first[1] + d[1], first[2] + d[2]);
    }
    return sum;
}

static bool in_box(const double p[3])
{
    for (int i = 0; i < 3; i++)
        if (p[i] < low[i] || p[i] > high[i]) return false;
    return true;
}

/* In cells that fill the box. */
static double in_cells(const int n[3], const double p[3], float (*number)(const void *, int, int, int))
{
    double place[3];
    for (int i = 0; i < 3; i++) place[i] = (p[i] - low[i]) / (high[i] - low[i]) * n[i] - 0.5;
    return in_box(p) ? between(n, place, number) : 0;
}

static void of_density(double density, truth_t *truth)
{
    for (int c = 0; c < 3; c++) {
        truth->absorption[c] = absorption[c] * density;
        truth->scattering[c] = scattering[c] * density;
    }
}

/* ---- scenes ----------------------------------------------------------------------------------------------
 */

/* The numbers of cells as text. */
static char *text_of(const int n[3], float (*number)(const void *, int, int, int))
{
    size_t count = (size_t)(n[0] * n[1] * n[2]), used = 0, room = 16 * count + 1;
    char *text = mem_zalloc(room, 1);
    for (size_t i = 0; i < count; i++) {
        int at = (int)i;
        float value = number(n, at % n[0], at / n[0] % n[1], at / (n[0] * n[1]));
        used += (size_t)snprintf(text + used, room - used, " %.7g", (double)value);
    }
    return text;
}

static scene_blob_t load(const char *medium, uint8_t **bytes)
{
    char *path = scratch_path(folder, "scene.pbrt");
    char *text =
        mem_printf("Film \"rgb\"\nWorldBegin\nLightSource \"point\"\nMakeNamedMedium \"m\" %s\n", medium);
    scratch_write(path, text, strlen(text));
    uint64_t size;
    scene_blob_t blob;
    result_t made = import_scene_blob(path, NULL, bytes, &size);
    if (made.code != RESULT_OK) fail_msg("%s", made.message);
    assert_int_equal(blob_open(*bytes, size, &blob).code, RESULT_OK);
    free(text);
    free(path);
    return blob;
}

/* ---- rays ------------------------------------------------------------------------------------------------
 */

typedef struct {
    double from[3], direction[3], distance;
} ray_t;

static ray_t ray_between(double x0, double y0, double z0, double x1, double y1, double z1)
{
    double d[3] = {x1 - x0, y1 - y0, z1 - z0}, length = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    return (ray_t){{x0, y0, z0}, {d[0] / length, d[1] / length, d[2] / length}, length};
}

/* What is left of light, what the ray collects, and what is scattered on it: all of it, and its moment. */
enum { LEFT, EMITTED, SCATTERED, MOMENT, KINDS };
typedef struct {
    double value[KINDS][3], square[KINDS][3];
} sums_t;

static sums_t integrate(truth_at_t at, const ray_t *ray)
{
    sums_t sums = {0};
    double depth[3] = {0}, step = ray->distance / STEPS;
    for (int i = 0; i < STEPS; i++) {
        double t = (i + 0.5) * step, p[3];
        truth_t truth = {0};
        for (int k = 0; k < 3; k++) p[k] = ray->from[k] + t * ray->direction[k];
        at(p, &truth);
        for (int c = 0; c < 3; c++) {
            double through = exp(-depth[c] - 0.5 * step * (truth.absorption[c] + truth.scattering[c]));
            sums.value[EMITTED][c] += through * truth.emission[c] * step;
            sums.value[SCATTERED][c] += through * truth.scattering[c] * step;
            sums.value[MOMENT][c] += through * truth.scattering[c] * step * t;
            depth[c] += step * (truth.absorption[c] + truth.scattering[c]);
        }
    }
    for (int c = 0; c < 3; c++) sums.value[LEFT][c] = exp(-depth[c]);
    return sums;
}

static void add(sums_t *sums, int kind, rgb_t rgb, double factor)
{
    const double v[3] = {(double)rgb.x * factor, (double)rgb.y * factor, (double)rgb.z * factor};
    for (int c = 0; c < 3; c++) {
        sums->value[kind][c] += v[c] / SAMPLES;
        sums->square[kind][c] += v[c] * v[c] / SAMPLES;
    }
}

/* Means of what the renderer makes of the ray. What goes on when nothing scatters counts for LEFT, too. */
static sums_t sample(const media_t *media, const ray_t *ray, sums_t *went_on)
{
    vec3_t from = vec3((float)ray->from[0], (float)ray->from[1], (float)ray->from[2]),
           direction = vec3((float)ray->direction[0], (float)ray->direction[1], (float)ray->direction[2]);
    float distance = (float)ray->distance;
    sums_t sums = {0};
    way_t way;
    way_forget(&way);
    *went_on = sums;
    for (uint64_t i = 0; i < SAMPLES; i++) {
        media_numbers_t numbers = {.first = -1, .key = sampler_mix(3 * i + 1)};
        add(&sums, LEFT, media_transmittance(media, 1, from, direction, distance, &numbers), 1);
        numbers = (media_numbers_t){.first = ((float)i + 0.5f) / SAMPLES, .key = sampler_mix(3 * i + 2)};
        if (media_emits(media, 1))
            add(&sums, EMITTED, media_emission(media, 1, from, direction, distance, &numbers), 1);
        numbers = (media_numbers_t){.first = ((float)i + 0.5f) / SAMPLES,
                                    .exact = i % 2 == 0,
                                    .way = i % 4 == 0 ? &way : NULL,
                                    .key = sampler_mix(3 * i + 3)};
        rgb_t throughput = {1, 1, 1};
        float at = 0;
        if (media_scatter(media, 1, from, direction, distance, &numbers, &throughput, &at)) {
            add(&sums, SCATTERED, throughput, 1);
            add(&sums, MOMENT, throughput, (double)at);
        } else {
            add(went_on, LEFT, throughput, 1);
        }
    }
    return sums;
}

/* Compares means with their truths; prints what differs. */
static bool agree(const char *name, int ray, const char *what, const sums_t *sums, const sums_t *truth,
                  int kind)
{
    bool holds = true;
    for (int c = 0; c < 3; c++) {
        double mean = sums->value[kind][c], expected = truth->value[kind][c];
        double variance = sums->square[kind][c] - mean * mean;
        double error = sqrt(fmax(variance, 0) / SAMPLES);
        double slack = 4.5 * error + 1e-3 * expected + 1e-6;
        bool close = fabs(mean - expected) < slack, sharp = error < 0.06 * expected + 1e-3;
        if (!close || !sharp)
            print_message("%s, ray %d, %s, channel %d: %g +- %g, but must be %g\n", name, ray, what, c, mean,
                          error, expected);
        holds = holds && close && sharp;
    }
    return holds;
}

static bool check(const char *name, const char *medium, truth_at_t at)
{
    const ray_t rays[] = {
        ray_between(-3, 0.5, 0.2, 3, 0.6, 0.3),       /* through all of it */
        ray_between(0.1, -3, -0.7, -0.2, 4, 1.2),     /* along y */
        ray_between(-0.9, -0.8, -0.9, 0.9, 1.8, 1.4), /* from inside to inside */
        ray_between(0.3, 0.4, -2, 0.3, 0.4, 0.75),    /* along an axis */
        ray_between(-2, 1.9, 0, 2, 0.3, 0.1),
    };
    uint8_t *bytes;
    scene_blob_t blob = load(medium, &bytes);
    media_t *media = media_new(&blob, false);
    bool holds = true;
    for (int i = 0; i < (int)ARRAY_LENGTH(rays); i++) {
        sums_t truth = integrate(at, &rays[i]), went_on, sums = sample(media, &rays[i], &went_on);
        holds = agree(name, i, "left", &sums, &truth, LEFT) && holds;
        holds = agree(name, i, "not scattered", &went_on, &truth, LEFT) && holds;
        holds = agree(name, i, "scattered", &sums, &truth, SCATTERED) && holds;
        holds = agree(name, i, "moment", &sums, &truth, MOMENT) && holds;
        holds = agree(name, i, "emitted", &sums, &truth, EMITTED) && holds;
    }
    media_destroy(&media);
    free(bytes);
    return holds;
}

/* ---- the tests -------------------------------------------------------------------------------------------
 */

static const int few[3] = {10, 15, 12}, many[3] = {10, 80, 12};

static void few_cells(const double p[3], truth_t *truth)
{
    of_density(in_cells(few, p, cell), truth);
}

static void many_cells(const double p[3], truth_t *truth)
{
    of_density(in_cells(many, p, cell), truth);
}

/* A file whose voxels stand where the middles of the cells do. */
static void pack(const int n[3], const char *name, float (*number)(const void *, int, int, int))
{
    nanovdb_pack_t grid = {.name = "density", .at = number, .context = n};
    for (int i = 0; i < 3; i++) {
        grid.high[i] = n[i] - 1;
        grid.voxel[i] = (high[i] - low[i]) / n[i];
        grid.origin[i] = low[i] + 0.5 * grid.voxel[i];
    }
    nanovdb_pack_t grids[2] = {grid, grid};
    grids[1].name = "temperature";
    char *path = scratch_path(folder, name);
    assert_true(nanovdb_pack(path, grids, 2, NANOVDB_PACK_ZIP));
    free(path);
}

/* Numbers that leave out the outermost cells, so that the box of what is active is not that of the cells. */
static float inner(const void *context, int x, int y, int z)
{
    const int *n = context;
    return x < 1 || y < 1 || z < 1 || x > n[0] - 2 || y > n[1] - 2 || z > n[2] - 2 ? 0
                                                                                   : 400 * cell(n, x, y, z);
}

/* The voxels that are active: from the lowest to the highest. */
typedef struct {
    const int *cells;
    int least[3], most[3];
} file_t;

static file_t file_of(const int n[3])
{
    file_t file = {n, {n[0], n[1], n[2]}, {0}};
    for (int i = 0; i < n[0] * n[1] * n[2]; i++) {
        const int at[3] = {i % n[0], i / n[0] % n[1], i / (n[0] * n[1])};
        if (inner(n, at[0], at[1], at[2]) == 0) continue;
        for (int k = 0; k < 3; k++) {
            file.least[k] = int_min(file.least[k], at[k]);
            file.most[k] = int_max(file.most[k], at[k]);
        }
    }
    return file;
}

/* As pbrt has it, there is nothing below the lowest voxel that is active, and from one above the highest on:
 * what is interpolated beyond the lowest is cut off. */
static double in_file(const file_t *file, const double p[3])
{
    double place[3];
    for (int i = 0; i < 3; i++) {
        place[i] = (p[i] - low[i]) / (high[i] - low[i]) * file->cells[i] - 0.5;
        if (place[i] < file->least[i] || place[i] > file->most[i] + 1) return 0;
    }
    return between(file->cells, place, inner);
}

/* Black bodies of 4 times the number in kelvin, by the blob's table. */
static double kelvin_of(double number)
{
    return 4 * number;
}

static const float *glow; /* the table, and its ends */
static double coldest, hottest;

static void glow_of(double number, double factor, truth_t *truth)
{
    double at = (number - coldest) / (hottest - coldest) * (BLOB_GLOW_STEPS - 1);
    if (!(at > 0)) return;
    int i = (int)fmin(at, BLOB_GLOW_STEPS - 2);
    for (int c = 0; c < 3; c++) {
        double a = (double)glow[3 * i + c], b = (double)glow[3 * (i + 1) + c];
        truth->emission[c] = factor * truth->absorption[c] * (a + (at - i) * (b - a));
    }
}

static file_t small, large;

static void file_of_few(const double p[3], truth_t *truth)
{
    double number = in_file(&small, p);
    of_density(number / 400, truth);
    glow_of(number, 2, truth);
}

static void file_of_many(const double p[3], truth_t *truth)
{
    double number = in_file(&large, p);
    of_density(number / 400, truth);
    glow_of(number, 2, truth);
}

/* Keeps the colours of a medium's temperatures. */
static uint8_t *keep_glow(const char *medium)
{
    uint8_t *bytes;
    scene_blob_t blob = load(medium, &bytes);
    const blob_medium_t *m = &blob.media[0];
    glow = blob.numbers + m->first_glow;
    coldest = (double)m->coldest;
    hottest = (double)m->hottest;
    assert_true(fabs(kelvin_of(coldest) - 100) < 1e-3 && hottest > 500);
    return bytes;
}

#define IN_FILE(file)                                                                                        \
    "\"string type\" \"nanovdb\" \"string filename\" \"" file "\" \"float scale\" 0.0025 \"float "           \
    "temperaturescale\" 4 \"float Lescale\" 2 " COEFFICIENTS

static void files_are_cells(void **state)
{
    (void)state;
    small = file_of(few);
    large = file_of(many);
    pack(few, "few.nvdb", inner);
    pack(many, "many.nvdb", inner);
    uint8_t *kept = keep_glow(IN_FILE("few.nvdb"));
    bool holds = check("few voxels", IN_FILE("few.nvdb"), file_of_few);
    free(kept);
    kept = keep_glow(IN_FILE("many.nvdb"));
    holds = check("many voxels", IN_FILE("many.nvdb"), file_of_many) && holds;
    free(kept);
    assert_true(holds);
}

/* Lescale, and temperatures, of other numbers in the same cells. */
static float strength(const void *context, int x, int y, int z)
{
    const int *n = context;
    return x < 0 || y < 0 || z < 0 || x >= n[0] || y >= n[1] || z >= n[2] ? 0 : 0.3f + 0.05f * (float)(x + z);
}

static float warmth(const void *context, int x, int y, int z)
{
    return 3000 * strength(context, x, z, y);
}

static void glowing_cells(const double p[3], truth_t *truth)
{
    few_cells(p, truth);
    static const double le[3] = {1, 2, 4};
    for (int c = 0; c < 3; c++)
        truth->emission[c] = truth->absorption[c] * le[c] * in_cells(few, p, strength);
}

static void warm_cells(const double p[3], truth_t *truth)
{
    many_cells(p, truth);
    glow_of(in_cells(many, p, warmth), in_cells(many, p, strength), truth);
}

static void grids_are_interpolated(void **state)
{
    (void)state;
#define UNIFORM(n, density, more)                                                                            \
    mem_printf("\"string type\" \"uniformgrid\" " BOX COEFFICIENTS                                            \
               "\"integer nx\" %d \"integer ny\" %d \"integer nz\" %d \"float density\" [%s] " more,         \
               (n)[0], (n)[1], (n)[2], density
    char *of_few = text_of(few, cell), *of_many = text_of(many, cell), *scale = text_of(few, strength),
         *scale_of_many = text_of(many, strength), *warm = text_of(many, warmth);
    char *medium = UNIFORM(few, of_few, "\"rgb Le\" [1 2 4] \"float Lescale\" [%s]"), scale);
    bool holds = check("cells that glow", medium, glowing_cells);
    free(medium);
    medium = UNIFORM(many, of_many, "\"float temperaturescale\" 4 \"float temperature\" [%s] \"float Lescale\" [%s]"),
             warm, scale_of_many);
    uint8_t *kept = keep_glow(medium);
    holds = check("cells that are warm", medium, warm_cells) && holds;
    free(kept);
    free(medium);
    free(of_few);
    free(of_many);
    free(scale);
    free(scale_of_many);
    free(warm);
    assert_true(holds);
}

/* Colours: each channel has its own pattern. */
static float colour(const void *context, int x, int y, int z)
{
    const int *n = context;
    return cell(n, x / 3, y, z) * (1 + 0.4f * (float)(x % 3));
}

static double colour_at(const double p[3], int c)
{
    double place[3], sum = 0;
    int first[3];
    for (int i = 0; i < 3; i++) {
        place[i] = (p[i] - low[i]) / (high[i] - low[i]) * few[i] - 0.5;
        first[i] = (int)floor(place[i]);
    }
    for (int k = 0; k < 8; k++) {
        double share = 1;
        int at[3];
        for (int i = 0; i < 3; i++) {
            int up = k >> i & 1;
            at[i] = first[i] + up;
            share *= up ? place[i] - first[i] : 1 - (place[i] - first[i]);
        }
        sum += share * (double)cell(few, at[0], at[1], at[2]) * (1 + 0.4 * c);
    }
    return sum;
}

static void coloured_cells(const double p[3], truth_t *truth)
{
    for (int c = 0; c < 3 && in_box(p); c++) {
        double tint = colour_at(p, c);
        truth->absorption[c] = 0.5 * tint;
        truth->scattering[c] = 0.5 * tint;
        truth->emission[c] = 0.5 * tint * tint * 0.01 * 106.856895;
    }
}

/* Only what scatters has cells: the rest of the box absorbs. */
static void half_coloured_cells(const double p[3], truth_t *truth)
{
    for (int c = 0; c < 3 && in_box(p); c++) {
        truth->absorption[c] = 0.5;
        truth->scattering[c] = 0.5 * colour_at(p, c);
    }
}

static void colours_are_interpolated(void **state)
{
    (void)state;
    size_t count = (size_t)(few[0] * few[1] * few[2]), used = 0, room = 48 * count + 1;
    char *text = mem_zalloc(room, 1);
    for (size_t i = 0; i < 3 * count; i++) {
        int at = (int)(i / 3), x = at % few[0];
        used += (size_t)snprintf(
            text + used, room - used, " %.7g",
            (double)colour(few, 3 * x + (int)(i % 3), at / few[0] % few[1], at / (few[0] * few[1])));
    }
#define RGB                                                                                                  \
    "\"string type\" \"rgbgrid\" \"float scale\" 0.5 " BOX                                                   \
    "\"integer nx\" 10 \"integer ny\" 15 \"integer nz\" 12 \"rgb sigma_s\" [%s] "
    char *medium =
        mem_printf(RGB "\"rgb sigma_a\" [%s] \"rgb Le\" [%s] \"float Lescale\" 0.01", text, text, text);
    bool holds = check("colours", medium, coloured_cells);
    free(medium);
    medium = mem_printf(RGB, text);
    holds = check("colours of what scatters", medium, half_coloured_cells) && holds;
    free(medium);
    free(text);
    assert_true(holds);
}

static void cloud(const double p[3], truth_t *truth)
{
    static const float parameters[3] = {1.5f, 1, 2};
    const float point[3] = {(float)p[0], (float)p[1], (float)p[2]};
    if (in_box(p)) of_density((double)cloud_density(parameters, point), truth);
}

static void clouds_are_sampled(void **state)
{
    (void)state;
    assert_true(check(
        "cloud", "\"string type\" \"cloud\" \"float density\" 1.5 \"float frequency\" 2 " BOX COEFFICIENTS,
        cloud));
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

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(files_are_cells),
        cmocka_unit_test(grids_are_interpolated),
        cmocka_unit_test(colours_are_interpolated),
        cmocka_unit_test(clouds_are_sampled),
    };
    return cmocka_run_group_tests_name("volumes", tests, begin, end);
}
