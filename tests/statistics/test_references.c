/* The renderer against images that another renderer made (tests/references/README.md): every integrator where
 * it can see, by the agreement test of client/image/agreement.h. Sample counts make the test sharp: a bias of
 * a few tenths of a percent of the image mean fails. */
#include "client/image/agreement.h"
#include "client/import/import.h"
#include "tests/reference.h"
#include "tests/render_here.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmocka.h>

/* From the command line: the one scene that is to be rendered, or "all", by all integrators; NULL: all
 * scenes, by those that tell most a second, with half the samples. */
static const char *wanted;

/* Renders the scene file; the noise is what the film's two halves tell. */
static estimate_image_t render(const char *scene_file, integrator_t integrator, uint32_t spp)
{
    uint8_t *bytes;
    uint64_t size;
    scene_blob_t blob;
    result_t made = import_scene_blob(scene_file, NULL, &bytes, &size);
    if (made.code != RESULT_OK) fail_msg("%s", made.message);
    assert_int_equal(blob_open(bytes, size, &blob).code, RESULT_OK);
    job_settings_t settings = blob_default_settings(&blob);
    settings.integrator = integrator;
    settings.spp = spp;
    settings.width = settings.height = 128; /* a glTF file does not say */
    settings.seed = 4;
    film_t *film = render_here(&blob, &settings);
    estimate_image_t estimate = reference_estimate(film);
    assert_int_equal(film->counts.dropped, 0);
    film_destroy(&film);
    free(bytes);
    return estimate;
}

/* One render that must agree. */
typedef struct {
    const char *scene, *file;
    integrator_t integrator;
    uint32_t spp;
} case_t;

/* Sample counts at which the standard error of the image mean is below 0.3 %, the reference's included; below
 * 0.45 % with half of them, which is still a bias of 2 %, and of a few percent of a block. A
 * path tracer meets the caustic too rarely for a test of seconds, sees no light through glass but by luck,
 * and in fog has specks where it comes close to the spot. Where there is next to no noise, what the pixels of
 * a block share of the luck of its light subpaths shows, which no pixel's noise tells: lights-delta has more.
 */
static const case_t cases[] = {
    {"seed-diffuse", "scene.pbrt", INTEGRATOR_BDPT, 128},
    {"seed-diffuse", "scene-v4.pbrt", INTEGRATOR_BDPT, 64},
    {"seed-diffuse", "seed-diffuse.glb", INTEGRATOR_BDPT, 64},
    {"seed-specular", "scene.pbrt", INTEGRATOR_BDPT, 128},
    {"seed-specular", "seed-specular.glb", INTEGRATOR_BDPT, 64},
    {"seed-hidden", "scene.pbrt", INTEGRATOR_BDPT, 128},
    {"seed-hidden", "scene-v4.pbrt", INTEGRATOR_BDPT, 64},
    {"seed-hidden", "seed-hidden.glb", INTEGRATOR_BDPT, 64},
    {"cornell", "scene.pbrt", INTEGRATOR_BDPT, 128},
    {"caustic", "scene.pbrt", INTEGRATOR_BDPT, 512},
    {"lights-delta", "scene.pbrt", INTEGRATOR_BDPT, 256},
    {"lights-env", "scene.pbrt", INTEGRATOR_BDPT, 256},
    {"materials", "scene.pbrt", INTEGRATOR_BDPT, 128},
    {"textures", "scene.pbrt", INTEGRATOR_BDPT, 128},
    {"instances", "scene.pbrt", INTEGRATOR_BDPT, 128},
    {"lens", "scene.pbrt", INTEGRATOR_BDPT, 256},
    {"fog", "scene.pbrt", INTEGRATOR_BDPT, 64},
    {"smoke", "scene.pbrt", INTEGRATOR_BDPT, 32},
    {"milk", "scene.pbrt", INTEGRATOR_BDPT, 64},
    {"fog-caustic", "scene.pbrt", INTEGRATOR_BDPT, 64},
};

/* Those that are only rendered where they are asked for: test_integrators and test_media say much the same,
 * and test_import_pbrt that two of the twins are the same scenes. */
static const case_t more_cases[] = {
    {"smoke", "scene.pbrt", INTEGRATOR_PATH, 32},
    {"seed-specular", "scene-v4.pbrt", INTEGRATOR_BDPT, 64},
    {"seed-diffuse", "scene.pbrt", INTEGRATOR_PATH, 256},
    {"seed-diffuse", "scene.pbrt", INTEGRATOR_LIGHT, 256},
    {"seed-specular", "scene.pbrt", INTEGRATOR_PATH, 512},
    {"cornell", "scene-v4.pbrt", INTEGRATOR_BDPT, 64},
    {"caustic", "scene-v4.pbrt", INTEGRATOR_BDPT, 512},
    {"lights-delta", "scene-v4.pbrt", INTEGRATOR_BDPT, 256},
    {"lights-delta", "scene.pbrt", INTEGRATOR_LIGHT, 512},
    {"lights-env", "scene.pbrt", INTEGRATOR_PATH, 512},
    {"materials", "scene.pbrt", INTEGRATOR_PATH, 512},
    {"lens", "scene.pbrt", INTEGRATOR_PATH, 512},
    {"seed-hidden", "scene.pbrt", INTEGRATOR_PATH, 256},
    {"cornell", "scene.pbrt", INTEGRATOR_PATH, 256},
    {"cornell", "scene.pbrt", INTEGRATOR_LIGHT, 256},
    {"lights-delta", "scene.pbrt", INTEGRATOR_PATH, 256},
    {"textures", "scene.pbrt", INTEGRATOR_PATH, 256},
    {"instances", "scene.pbrt", INTEGRATOR_PATH, 512},
};

/* Under a sanitizer, which is many times slower, a few samples must do, whose noise is known badly: what is
 * far off still shows, the rest is another build's business. */
#ifdef __SANITIZE_ADDRESS__
enum { SPARSER = 16 };
#else
enum { SPARSER = 1 };
#endif

/* The standard error of the image means' difference, relative to the mean, of the worst channel. */
static double mean_error(const estimate_image_t *image, const estimate_image_t *reference)
{
    double worst = 0;
    size_t values = 3 * (size_t)image->width * (size_t)image->height;
    for (size_t c = 0; c < 3; c++) {
        double sum = 0, variance = 0;
        for (size_t i = c; i < values; i += 3) {
            sum += reference->mean[i];
            variance += image->variance[i] + reference->variance[i];
        }
        worst = fmax(worst, sqrt(variance) / sum);
    }
    return worst;
}

static bool check(const case_t *c)
{
    char path[256];
    snprintf(path, sizeof path, "scenes/%s/%s", c->scene, c->file);
    estimate_image_t reference = reference_read(c->scene), image = render(path, c->integrator, c->spp);
    agreement_t agreement;
    agreement_limits_t limits = agreement_default_limits();
    agreement_measure(&image, &reference, &agreement);
    double error = mean_error(&image, &reference), most_error = wanted ? 0.003 : 0.0045;
    /* With fewer samples two halves know the noise of blocks with specks worse. */
    if (!wanted) limits.max_z = 8;
    /* Of light that goes through glass into haze and back through glass, which makes bright dots. */
    if (strcmp(c->scene, "fog-caustic") == 0) most_error = wanted ? 0.015 : 0.022;
    /* To a path tracer caustics behind a mirror are specks, so few and so bright that two halves know the
     * noise of a block badly. */
    if (strcmp(c->scene, "seed-specular") == 0 && c->integrator == INTEGRATOR_PATH) limits.max_z = 10;
    if (SPARSER > 1) limits = (agreement_limits_t){.max_rms = 2, .max_z = 15, .max_mean_z = 6};
    bool holds = agreement_holds(&agreement, &limits) && (error < most_error || SPARSER > 1);
    print_message(
        "%s %s: relMSE %.6f, mean ratio %.4f %.4f %.4f, z rms %.3f max %.2f, error of the mean %.2f %%%s\n",
        path, integrator_name(c->integrator), agreement.relmse, agreement.mean_ratio[0],
        agreement.mean_ratio[1], agreement.mean_ratio[2], agreement.rms_z, agreement.max_z, 100 * error,
        holds ? "" : "  <-- differs");
    agreement_free(&agreement);
    estimate_image_free(&reference);
    estimate_image_free(&image);
    return holds;
}

/* Which of both tables' cases are rendered: with how many samples, 0: not at all. */
static uint32_t samples_wanted(const case_t *c, bool more)
{
    if (wanted == NULL ? more : strcmp(wanted, "all") != 0 && strcmp(wanted, c->scene) != 0) return 0;
    if (SPARSER > 1) return c->integrator == INTEGRATOR_BDPT ? c->spp / SPARSER : 0;
    return wanted ? c->spp : c->spp / 2;
}

/* Renders the cases, as long as no other process has taken the next; returns how many differ. The last in
 * the table, which take longest, come first. */
static int check_cases(atomic_uint *taken)
{
    int differing = 0;
    for (unsigned i; (i = atomic_fetch_add(taken, 1)) < ARRAY_LENGTH(cases) + ARRAY_LENGTH(more_cases);) {
        bool more = i >= ARRAY_LENGTH(cases);
        case_t c = more ? more_cases[i - ARRAY_LENGTH(cases)] : cases[ARRAY_LENGTH(cases) - 1 - i];
        c.spp = samples_wanted(&c, more);
        if (c.spp > 0) differing += !check(&c);
    }
    return differing;
}

/* A process for each core: renders here take one thread. */
static void scenes_agree(void **state)
{
    (void)state;
    size_t processes = (size_t)sysconf(_SC_NPROCESSORS_ONLN);
    atomic_uint *taken = mmap(NULL, sizeof *taken, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    assert_true(taken != MAP_FAILED);
    for (size_t k = 0; k < processes; k++) {
        fflush(NULL);
        pid_t child = fork();
        assert_true(child >= 0);
        if (child == 0) _exit(check_cases(taken) == 0 && fflush(NULL) == 0 ? 0 : 1);
    }
    int failures = 0, status;
    for (size_t k = 0; k < processes; k++) {
        assert_true(wait(&status) > 0);
        failures += !(WIFEXITED(status) && WEXITSTATUS(status) == 0);
    }
    assert_int_equal(failures, 0);
    munmap(taken, sizeof *taken);
}

/* The test must tell a wrong image: a camera pushed off by one pixel, a light dimmer by 1 %. */
static void disagreement_shows(void **state)
{
    (void)state;
    estimate_image_t reference = reference_read("cornell");
    estimate_image_t image = render("scenes/cornell/scene.pbrt", INTEGRATOR_PATH, 192);
    agreement_limits_t limits = agreement_default_limits();
    agreement_t agreement;
    size_t values = 3 * (size_t)image.width * (size_t)image.height;
    for (size_t i = 0; i < values; i++) image.mean[i] *= 0.99;
    agreement_measure(&image, &reference, &agreement);
    assert_false(agreement_holds(&agreement, &limits));
    agreement_free(&agreement);
    for (size_t i = values - 1; i >= 3; i--) image.mean[i] = image.mean[i - 3] / 0.99;
    agreement_measure(&image, &reference, &agreement);
    assert_false(agreement_holds(&agreement, &limits));
    agreement_free(&agreement);
    estimate_image_free(&reference);
    estimate_image_free(&image);
}

int main(int argc, char **argv)
{
    wanted = argc > 1 ? argv[1] : NULL;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(scenes_agree),
        cmocka_unit_test(disagreement_shows),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
