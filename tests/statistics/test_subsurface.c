/* Light that is scattered below surfaces (blob_material_t.body) against what is known of it: bodies that
 * absorb nothing vanish in an even light, those of a colour have it, light that comes far through a medium
 * fades as the theory of diffusion has it; against the same media written out; and the integrators against
 * one another. */
#include "client/import/import.h"
#include "client/import/scene/half_space.h"
#include "tests/reference.h"
#include "tests/render_here.h"
#include "tests/scratch.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static char *folder;

/* ---- scenes -------------------------------------------------------------------------------------------- */

#define HEAD(camera, side)                                                                                   \
    camera "Film \"image\" \"integer xresolution\" [" side "] \"integer yresolution\" [" side "]\n"          \
           "PixelFilter \"box\" \"float xwidth\" [0.5] \"float ywidth\" [0.5]\nSampler \"sobol\"\n"          \
           "Integrator \"volpath\"\nWorldBegin\n"
#define AHEAD "LookAt 0 0 -5  0 0 0  0 1 0\nCamera \"orthographic\" \"float screenwindow\" [-1 1 -1 1]\n"
#define ABOVE "LookAt 0 1 -5  0 0 0  0 1 0\nCamera \"perspective\" \"float fov\" [30]\n"
#define SKY "LightSource \"infinite\" \"rgb L\" [1 1 1]\n"
#define SMOOTH_SKY "LightSource \"infinite\" \"rgb L\" [0.1 0.1 0.1]\n"
#define POINT "LightSource \"point\" \"rgb I\" [10 9 8] \"point from\" [2 3 -2]\n"
/* So wide that all integrators find it, with some light from all around. */
#define LAMP                                                                                                 \
    "LightSource \"infinite\" \"rgb L\" [0.2 0.25 0.3]\nAttributeBegin\nAreaLightSource \"diffuse\" \"rgb "  \
    "L\" "                                                                                                   \
    "[3 2.7 2.4]\nTranslate 3 3.5 -3\nShape \"sphere\" \"float radius\" [1.8]\nAttributeEnd\n"
#define FLOOR                                                                                                \
    "Material \"matte\" \"rgb Kd\" [0.5 0.5 0.5]\nShape \"trianglemesh\" \"integer indices\" [0 1 2 0 2 3] " \
    "\"point P\" [-4 -1 -4  4 -1 -4  4 -1 4  -4 -1 4]\n"
#define BALL "Shape \"sphere\"\n"
#define ROUGH "\"float uroughness\" [0.3] \"float vroughness\" [0.3] \"bool remaproughness\" \"false\" "

static estimate_image_t render(const char *text, integrator_t integrator, uint32_t spp, int max_depth)
{
    char *path = scratch_path(folder, "scene.pbrt");
    scratch_write(path, text, strlen(text));
    uint8_t *bytes;
    uint64_t size;
    scene_blob_t blob;
    result_t made = import_scene_blob(path, NULL, &bytes, &size);
    if (made.code != RESULT_OK) fail_msg("%s", made.message);
    assert_int_equal(blob_open(bytes, size, &blob).code, RESULT_OK);
    job_settings_t settings = blob_default_settings(&blob);
    settings.integrator = integrator;
    settings.spp = spp;
    settings.max_depth = max_depth;
    settings.seed = 5;
    if (integrator == INTEGRATOR_VCM) settings.merge_radius = 0.03;
    film_t *film = render_here(&blob, &settings);
    estimate_image_t image = reference_estimate(film);
    assert_int_equal(film->counts.dropped, 0);
    assert_int_equal(film->counts.overflows, 0);
    film_destroy(&film);
    free(bytes);
    free(path);
    return image;
}

/* Mean of a channel over the whole image, and its standard error. */
static double mean_of(const estimate_image_t *image, int channel, double *error)
{
    size_t count = (size_t)image->width * image->height;
    double sum = 0, variance = 0;
    for (size_t i = 0; i < count; i++) {
        sum += image->mean[3 * i + (size_t)channel];
        variance += image->variance[3 * i + (size_t)channel];
    }
    *error = sqrt(variance) / (double)count;
    return sum / (double)count;
}

/* Whether the mean is what it should be, by so much at most beyond its noise, which is no more than that. */
static bool has_mean(const char *what, integrator_t integrator, const estimate_image_t *image,
                     const double expected[3], double tolerance)
{
    bool holds = true;
    for (int c = 0; c < 3; c++) {
        double error, mean = mean_of(image, c, &error);
        bool close = fabs(mean - expected[c]) < tolerance + 3 * error && error < tolerance;
        print_message("%-20s %-5s channel %d: %.4f +- %.4f, expected %.4f%s\n", what,
                      integrator_name(integrator), c, mean, error, expected[c], close ? "" : "  <-- differs");
        holds = holds && close;
    }
    return holds;
}

/* ---- in an even light ---------------------------------------------------------------------------------- */

/* What a picture of the ball in the sky comes to, whose surface has this index and whose inside gives back so
 * much. The ball shows all angles alike, by their cosines. */
static double ball_in_sky(double eta, double share)
{
    enum { STEPS = 10000 };
    double reflected = 0;
    for (int i = 0; i < STEPS; i++) {
        double outside = sqrt((i + 0.5) / STEPS), inside = sqrt(1 - (1 - outside * outside) / (eta * eta));
        double s = (outside - eta * inside) / (outside + eta * inside);
        double p = (eta * outside - inside) / (eta * outside + inside);
        reflected += (s * s + p * p) / 2 / STEPS;
    }
    return 1 - M_PI / 4 * (1 - reflected) * (1 - share);
}

/* Light is scattered below the surface some hundred times, though paths have one scattering alone; also where
 * floats are so coarse that many a flight ends where it began. */
static void white_bodies_vanish(void **state)
{
    (void)state;
    static const char near[] = HEAD(AHEAD, "16") SKY
        "Material \"kdsubsurface\" \"rgb Kd\" [1 1 1] \"float eta\" [1.4] \"rgb mfp\" [0.1 0.1 0.1]\n" BALL
        "WorldEnd\n";
    static const char far[] = HEAD("LookAt 30 30 20  30 30 30  0 1 0\n"
                                   "Camera \"orthographic\" \"float screenwindow\" [-0.05 0.05 -0.05 0.05]\n",
                                   "16") SKY
        "Material \"kdsubsurface\" \"rgb Kd\" [1 1 1] \"float eta\" [1.4] \"rgb mfp\" [1e-3 1e-3 1e-3]\n"
        "Translate 30 30 30\nShape \"sphere\" \"float radius\" [0.05]\nWorldEnd\n";
    static const double one[3] = {1, 1, 1};
    static const integrator_t integrators[] = {INTEGRATOR_PATH, INTEGRATOR_BDPT};
    bool holds = true;
    for (size_t i = 0; i < 2 * ARRAY_LENGTH(integrators); i++) {
        integrator_t integrator = integrators[i / 2];
        estimate_image_t image =
            i % 2 == 0 ? render(near, integrator, 32, 1) : render(far, integrator, 64, 1);
        holds = (i % 2 == 0 ? has_mean("white", integrator, &image, one, 0.01)
                            : has_mean("white, far away", integrator, &image, one, 0.02)) &&
                holds;
        estimate_image_free(&image);
    }
    assert_true(holds);
}

/* Where the ball is large against the mean free path, it gives back its colour of what has entered; also
 * where a texture says so (which is 0.2 in all of red that is seen, but could be 0.8). */
static void bodies_have_their_colour(void **state)
{
    (void)state;
#define TINY "\"rgb mfp\" [0.001 0.001 0.001] \"float eta\" [1.4]\n"
    static const char plain[] =
        HEAD(AHEAD, "16") SKY "Material \"kdsubsurface\" \"rgb Kd\" [0.2 0.5 0.8] " TINY BALL "WorldEnd\n";
    static const char skewed[] = HEAD(AHEAD, "16") SKY
        "Material \"kdsubsurface\" \"rgb Kd\" [0.4 0.6 0.8] \"float g\" [0.6] " TINY BALL "WorldEnd\n";
    static const char varied[] = HEAD(AHEAD, "16") SKY
        "Texture \"t\" \"spectrum\" \"checkerboard\" \"rgb tex1\" [0.2 0.3 0.5] \"rgb tex2\" [0.8 0.9 0.5] "
        "\"float uscale\" [0.001] \"float vscale\" [0.001]\n"
        "Material \"kdsubsurface\" \"texture Kd\" \"t\" " TINY BALL "WorldEnd\n";
    static const struct {
        const char *name, *text;
        double colour[3];
    } cases[] = {{"colour", plain, {0.2, 0.5, 0.8}},
                 {"colour, forwards", skewed, {0.4, 0.6, 0.8}},
                 {"colour of a texture", varied, {0.2, 0.3, 0.5}}};
    bool holds = true;
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        double expected[3];
        for (int c = 0; c < 3; c++) expected[c] = ball_in_sky(1.4, cases[i].colour[c]);
        estimate_image_t image = render(cases[i].text, INTEGRATOR_PATH, 32, 1);
        holds = has_mean(cases[i].name, INTEGRATOR_PATH, &image, expected, 0.006) && holds;
        estimate_image_free(&image);
    }
    assert_true(holds);
}

/* ---- far from the light -------------------------------------------------------------------------------- */

/* How many scatterings there are per volume at a distance r from a point of power 1 in a medium without end
 * whose extinction is 1, over the albedo a: the exact solution of the equation of transfer, and not the
 * theory of diffusion (Case and Zweifel 1967, "Linear Transport Theory", section 2.6). Far away it is that of
 * diffusion, exp(-k r) / r, with a / (2 k) log((1 + k) / (1 - k)) = 1. */
static double density_at(double a, double r)
{
    enum { STEPS = 400 };
    double low = 1e-6, high = 1 - 1e-12, near = 0;
    for (int i = 0; i < 60; i++) {
        double k = (low + high) / 2;
        *(a / (2 * k) * log((1 + k) / (1 - k)) < 1 ? &low : &high) = k;
    }
    double k = low, far = 2 * k * k * (1 - k * k) / (a * (k * k + a - 1)) * exp(-k * r);
    for (int i = 0; i < STEPS; i++) {
        double m = (i + 0.5) / STEPS, real = 1 - a * m * atanh(m), imaginary = M_PI / 2 * a * m;
        near += exp(-r / m) / (m * m * (real * real + imaginary * imaginary)) / STEPS;
    }
    return (far + near) / (4 * M_PI * r);
}

enum { TABLE = 800 };
static const double farthest = 40;

/* What one sees of it that looks past the point, at a distance of r, from where the point is. */
static double seen_at(double a, const double table[TABLE], double r)
{
    const double step = 0.02;
    double sum = 0;
    for (double s = step / 2; s < 25; s += step) {
        double place = hypot(r, s) / farthest * TABLE - 0.5;
        size_t i = (size_t)place;
        double density = table[i] + (place - (double)i) * (table[i + 1] - table[i]);
        sum += exp(-s) * density * step;
    }
    return a / (4 * M_PI) * sum;
}

/* A lamp in a medium without end. */
static void light_diffuses(void **state)
{
    (void)state;
    enum { SIDE = 48, RINGS = 4 };
    static const char text[] = HEAD(
        "MakeNamedMedium \"m\" \"string type\" \"homogeneous\" \"rgb sigma_a\" [0.1 0.1 0.1] \"rgb sigma_s\" "
        "[0.9 0.9 0.9]\nMediumInterface \"m\" \"m\"\nLookAt 0 0 0  0 0 1  0 1 0\nCamera \"orthographic\" "
        "\"float screenwindow\" [-12 12 -12 12]\n",
        "48") "LightSource \"point\" \"rgb I\" [100 100 100]\nWorldEnd\n";
    static const double rings[RINGS][2] = {{1, 1.5}, {3, 3.5}, {6, 7}, {10, 12}};
    double table[TABLE + 1], seen[RINGS] = {0}, expected[RINGS] = {0}, variance[RINGS] = {0};
    for (int i = 0; i <= TABLE; i++) table[i] = density_at(0.9, (i + 0.5) * farthest / TABLE);
    estimate_image_t image = render(text, INTEGRATOR_LIGHT, 256, 100);
    for (int i = 0; i < SIDE * SIDE; i++) {
        double x = 24 * (i % SIDE + 0.5) / SIDE - 12, y = 24 * (i / SIDE + 0.5) / SIDE - 12, r = hypot(x, y);
        for (int k = 0; k < RINGS; k++) {
            if (r < rings[k][0] || r > rings[k][1]) continue;
            seen[k] += image.mean[3 * (size_t)i];
            variance[k] += image.variance[3 * (size_t)i];
            expected[k] += 100 * 4 * M_PI * seen_at(0.9, table, r);
        }
    }
    estimate_image_free(&image);
    bool holds = true;
    for (int k = 0; k < RINGS; k++) {
        double ratio = seen[k] / expected[k], error = sqrt(variance[k]) / expected[k];
        bool close = error < 0.03 && fabs(ratio - 1) < 0.02 + 3 * error;
        print_message("diffusion, %g to %g: %.4f +- %.4f of what is expected%s\n", rings[k][0], rings[k][1],
                      ratio, error, close ? "" : "  <-- differs");
        holds = holds && close;
    }
    assert_true(holds);
}

/* ---- one way and another ------------------------------------------------------------------------------- */

/* What `light` sees comes in rare bright splats: of it the mean alone can be told. */
static bool agree(const char *what, integrator_t integrator, const estimate_image_t *image,
                  const estimate_image_t *reference)
{
    bool rare = integrator == INTEGRATOR_LIGHT;
    agreement_t agreement;
    agreement_limits_t limits = agreement_default_limits();
    limits.max_rms = 1.5; /* of few blocks, whose channels go together */
    agreement_measure(image, reference, &agreement);
    double error, mean = mean_of(image, 1, &error);
    bool sharp = error < (rare ? 0.1 : 0.02) * mean, holds = agreement_holds(&agreement, &limits) || rare;
    for (int c = 0; c < 3; c++) holds = holds && fabs(agreement.mean_z[c]) < 4;
    print_message(
        "%-20s %-5s mean %.4f, ratio %.4f %.4f %.4f, error %.4f, z mean %.1f %.1f %.1f rms %.2f max "
        "%.2f%s%s\n",
        what, integrator_name(integrator), mean, agreement.mean_ratio[0], agreement.mean_ratio[1],
        agreement.mean_ratio[2], error / mean, agreement.mean_z[0], agreement.mean_z[1], agreement.mean_z[2],
        agreement.rms_z, agreement.max_z, holds ? "" : "  <-- differs", sharp ? "" : " (too noisy)");
    agreement_free(&agreement);
    return holds && sharp;
}

#define WAX "\"rgb sigma_a\" [0.2 0.4 0.8] \"rgb sigma_s\" [4 3 2] "
#define HIDDEN(more) "Material \"subsurface\" " WAX "\"float g\" [0.3] \"float eta\" [1.4] " more "\n" BALL
#define WRITTEN(more)                                                                                        \
    "MakeNamedMedium \"m\" \"string type\" \"homogeneous\" " WAX "\"float g\" [0.3]\nMediumInterface \"m\" " \
    "\"\"\nMaterial \"glass\" \"float eta\" [1.4] " more "\n" BALL

/* The same medium inside the same glass. All light crosses the ball's surface twice, so paths of a subsurface
 * material that may scatter once alone have all of it. */
static void bodies_are_glass_with_a_medium(void **state)
{
    (void)state;
#define PAIR(what)                                                                                           \
    {                                                                                                        \
        HEAD(ABOVE, "24") what HIDDEN("") "WorldEnd\n", HEAD(ABOVE, "24") what WRITTEN("") "WorldEnd\n"      \
    }
#define ROUGH_PAIR(what)                                                                                     \
    {                                                                                                        \
        HEAD(ABOVE, "24")                                                                                    \
        what HIDDEN(ROUGH) "WorldEnd\n", HEAD(ABOVE, "24") what WRITTEN(ROUGH) "WorldEnd\n"                  \
    }
    static const struct {
        const char *name;
        integrator_t integrator;
        uint32_t spp;
        const char *texts[2];
    } cases[] = {{"lamp on wax", INTEGRATOR_PATH, 64, ROUGH_PAIR(LAMP)},
                 {"lamp on wax", INTEGRATOR_BDPT, 32, ROUGH_PAIR(LAMP)},
                 {"lamp on wax", INTEGRATOR_LIGHT, 128, ROUGH_PAIR(LAMP)},
                 {"point on smooth wax", INTEGRATOR_BDPT, 64, PAIR(SMOOTH_SKY POINT)}};
    bool holds = true;
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        estimate_image_t body = render(cases[i].texts[0], cases[i].integrator, cases[i].spp, 1);
        estimate_image_t glass = render(cases[i].texts[1], cases[i].integrator, cases[i].spp, 100);
        holds = agree(cases[i].name, cases[i].integrator, &body, &glass) && holds;
        estimate_image_free(&body);
        estimate_image_free(&glass);
    }
    assert_true(holds);
}

/* Rough wax; the same with a ball that nothing lights but what comes through it, and with a lamp; Disney's.
 */
static void integrators_agree(void **state)
{
    (void)state;
    static const struct {
        const char *name, *text;
        uint32_t samples[3]; /* 0: not by this one */
    } cases[] = {
        {"wax in the sky", HEAD(ABOVE, "24") SKY HIDDEN(ROUGH) "WorldEnd\n", {32, 512, 24}},
        {"wax", HEAD(ABOVE, "24") LAMP FLOOR HIDDEN(ROUGH) "WorldEnd\n", {32, 0, 24}},
        {"wax with a core",
         HEAD(ABOVE, "24") LAMP HIDDEN(ROUGH) "Material \"matte\" \"rgb Kd\" [0.8 0.3 0.1]\n"
                                              "Shape \"sphere\" \"float radius\" [0.6]\nWorldEnd\n",
         {32, 0, 24}},
        {"lamp in wax",
         HEAD(ABOVE, "24") HIDDEN(ROUGH) "Material \"matte\" \"rgb Kd\" [0.8 0.3 0.1]\nAreaLightSource "
                                         "\"diffuse\" \"rgb L\" [3 2.7 2.4]\n"
                                         "Shape \"sphere\" \"float radius\" [0.4]\nWorldEnd\n",
         {32, 0, 24}},
        {"disney",
         HEAD(ABOVE, "24") LAMP FLOOR
         "Material \"disney\" \"color color\" [0.8 0.5 0.3] \"float roughness\" [0.6] \"color "
         "scatterdistance\" "
         "[1 0.6 0.3] \"float metallic\" [0.2] \"float sheen\" [0.5] \"float clearcoat\" [0.3] \"float eta\" "
         "[1.4]\n" BALL "WorldEnd\n",
         {32, 0, 24}}};
    static const integrator_t others[] = {INTEGRATOR_BDPT, INTEGRATOR_LIGHT, INTEGRATOR_VCM};
    bool holds = true;
    for (size_t i = 0; i < ARRAY_LENGTH(cases); i++) {
        estimate_image_t path = render(cases[i].text, INTEGRATOR_PATH, 128, 3);
        for (size_t k = 0; k < ARRAY_LENGTH(others); k++) {
            if (cases[i].samples[k] == 0) continue;
            estimate_image_t image = render(cases[i].text, others[k], cases[i].samples[k], 3);
            holds = agree(cases[i].name, others[k], &image, &path) && holds;
            estimate_image_free(&image);
        }
        estimate_image_free(&path);
    }
    assert_true(holds);
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
        cmocka_unit_test(white_bodies_vanish), cmocka_unit_test(bodies_have_their_colour),
        cmocka_unit_test(light_diffuses),      cmocka_unit_test(bodies_are_glass_with_a_medium),
        cmocka_unit_test(integrators_agree),
    };
    return cmocka_run_group_tests(tests, begin, end);
}
