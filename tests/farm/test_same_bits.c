/* The same job gives the same pixels, bit for bit, however it is computed: with one thread or two, in one
 * process, on a farm of one, two or three worker processes, and on a farm that loses two of three workers
 * half-way; also when the job goes by rounds that its own noise decides. */
#include "common/image/image.h"
#include "tests/rig.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
/* After setjmp and stdarg. */
#include <cmocka.h>

/* All layers are in the file, or without features only the first. */
static void check_layers(const char *path, bool features)
{
    static const char *const names[] = {"R",       "eye.G",     "light.B",     "noise.R",
                                        "samples", "albedo.R",  "normal.Y",    "position.Z",
                                        "depth.Z", "object.id", "material.id", "coverage"};
    enum { ALWAYS = 5 };
    image_t image;
    assert_int_equal(image_read_exr(path, &image).code, RESULT_OK);
    assert_int_equal(image.channel_count, features ? 26 : 13);
    for (size_t i = 0; i < ARRAY_LENGTH(names); i++)
        assert_int_equal(image_find(&image, names[i]) != NULL, features || i < ALWAYS);
    image_free(&image);
}

/* What is rendered most often; its samples a pixel, and those of each kind of scene. */
static const char SCENE[] = "scenes/seed-hidden";
#ifdef __SANITIZE_THREAD__
enum { SPP = 4, SPP_EACH = 1 };
#else
enum { SPP = 32, SPP_EACH = 8 };
#endif

/* Renders a scene with one more option; returns the hash of its pixels, all layers. */
static hash_t render_waves(const char *integrator, const char *scene, int samples, bool spectral,
                           const char *option, const char *value)
{
    rig_t *rig = rig_new();
    char *path = scratch_path(rig->folder, "image.exr"), *spp = mem_printf("%d", samples);
    const char *const words[] = {"render", scene,          "--spp",    spp,    "--quiet", "-o",
                                 path,     "--integrator", integrator, option, value,     NULL};
    const char *arguments[ARRAY_LENGTH(words) + 1] = {"render", "--spectral"};
    memcpy(arguments + (spectral ? 2 : 1), words + 1, sizeof words - sizeof *words);
    assert_int_equal(rig_run(rig, arguments), 0);
    check_layers(path, strcmp(option, "--no-layers") != 0);
    hash_t hash = rig_file_hash(path);
    free(path);
    free(spp);
    rig_destroy(&rig);
    return hash;
}

static hash_t render_by(const char *integrator, const char *scene, int samples, const char *option,
                        const char *value)
{
    return render_waves(integrator, scene, samples, false, option, value);
}

static hash_t render_scene(const char *scene, int samples, const char *option, const char *value)
{
    return render_by("bdpt", scene, samples, option, value);
}

static hash_t render(const char *option, const char *value)
{
    return render_scene(SCENE, SPP, option, value);
}

static void threads_and_workers_make_no_difference(void **state)
{
    (void)state;
    static const char *const ways[][2] = {{"--threads", "2"},
                                          {"--workers", "1"},
                                          {"--workers", "2"},
                                          {"--workers", "3"},
                                          {"--tile-size", "50"}};
    hash_t first = render_scene(SCENE, SPP / 2, "--threads", "1");
    for (size_t i = 0; i < ARRAY_LENGTH(ways); i++) {
        hash_t hash = render_scene(SCENE, SPP / 2, ways[i][0], ways[i][1]);
        if (!hash_equal(&first, &hash)) fail_msg("%s %s gives another image", ways[i][0], ways[i][1]);
    }
}

/* Photons are made by whoever needs them first, together, and anew in each process. */
static void photons_keep_their_bits(void **state)
{
    (void)state;
    static const char *const ways[][2] = {{"--threads", "2"}, {"--workers", "3"}, {"--tile-size", "50"}};
    const char *scene = "tests/statistics/pool.pbrt";
    hash_t first = render_by("vcm", scene, SPP_EACH, "--threads", "1");
    for (size_t i = 0; i < ARRAY_LENGTH(ways); i++) {
        hash_t hash = render_by("vcm", scene, SPP_EACH, ways[i][0], ways[i][1]);
        if (!hash_equal(&first, &hash)) fail_msg("%s %s gives another image by vcm", ways[i][0], ways[i][1]);
    }
}

/* Materials that draw random numbers of their own, textures, alpha, lights of every kind, things that move,
 * and media. */
static void every_kind_of_scene_keeps_its_bits(void **state)
{
    (void)state;
    static const char *const scenes[] = {"scenes/materials", "scenes/textures", "scenes/lights-env",
                                         "tests/farm/everything.pbrt", "tests/farm/media.pbrt"};
    for (size_t i = 0; i < ARRAY_LENGTH(scenes); i++) {
        hash_t one = render_scene(scenes[i], SPP_EACH, "--threads", "1");
        hash_t two = render_scene(scenes[i], SPP_EACH, "--workers", "2");
        if (!hash_equal(&one, &two)) fail_msg("two workers make another image of %s", scenes[i]);
    }
}

/* Wavelengths, and the table by which colours become spectra, which each process makes by itself. */
static void wavelengths_keep_their_bits(void **state)
{
    (void)state;
    const char *scene = "tests/farm/everything.pbrt";
    hash_t one = render_waves("bdpt", scene, SPP_EACH / 2 + 1, true, "--threads", "1");
    hash_t two = render_waves("bdpt", scene, SPP_EACH / 2 + 1, true, "--workers", "2");
    assert_true(hash_equal(&one, &two));
    hash_t rgb = render_scene(scene, SPP_EACH / 2 + 1, "--threads", "1");
    assert_false(hash_equal(&one, &rgb));
}

static void layers_can_be_left_out(void **state)
{
    (void)state;
    render_scene("scenes/seed-hidden", 1, "--no-layers", NULL);
}

static void another_seed_gives_another_image(void **state)
{
    (void)state;
    hash_t a = render_scene("scenes/seed-hidden", 1, "--seed", "1"),
           b = render_scene("scenes/seed-hidden", 1, "--seed", "2");
    assert_false(hash_equal(&a, &b));
}

static void losing_workers_makes_no_difference(void **state)
{
    (void)state;
    hash_t reference = render("--threads", "2");
    rig_t *rig = rig_new();
    rig_start_master(rig, 0.2);
    pid_t workers[3];
    for (int i = 0; i < 3; i++) workers[i] = rig_start_worker(rig);
    rig_wait_workers(rig, 3);
    job_settings_t settings = rig_settings();
    settings.width = settings.height = 128;
    settings.spp = SPP;
    settings.seed = 0;
    uint64_t job = rig_submit(rig, &settings);
    rig_wait_samples(rig, job, 128 * 128 * SPP / 2);
    kill(workers[0], SIGKILL);
    kill(workers[1], SIGSTOP);
    assert_int_equal(rig_wait_job(rig, job).state, JOB_DONE);
    hash_t hash = rig_image_hash(rig, job);
    assert_true(hash_equal(&hash, &reference));
    rig_destroy(&rig);
}

/* Media, in colours or in wavelengths, while a worker dies, another one stops and the master is killed. */
static void media_survive(bool spectral)
{
    const char *scene = "tests/farm/media.pbrt";
    hash_t reference = render_waves("bdpt", scene, SPP, spectral, "--threads", "2");
    rig_t *rig = rig_new();
    rig_start_master(rig, 0.2);
    pid_t workers[3];
    for (int i = 0; i < 3; i++) workers[i] = rig_start_worker(rig);
    rig_wait_workers(rig, 3);
    char *address = mem_printf("127.0.0.1:%d", rig->port), *spp = mem_printf("%d", SPP);
    assert_int_equal(rig_run(rig, ARGUMENTS("submit", scene, "--master", address, "--spp", spp,
                                            spectral ? "--spectral" : NULL)),
                     0);
    rig_wait_samples(rig, 1, 64 * 64 * SPP / 4);
    kill(workers[0], SIGKILL);
    rig_wait_samples(rig, 1, 64 * 64 * SPP / 2);
    kill(workers[1], SIGSTOP);
    assert_int_not_equal(rig_status(rig, 1).state, JOB_DONE);
    rig_kill_master(rig);
    rig_restart_master(rig, 0.2);
    assert_int_equal(rig_wait_job(rig, 1).state, JOB_DONE);
    hash_t hash = rig_image_hash(rig, 1);
    assert_true(hash_equal(&hash, &reference));
    free(address);
    free(spp);
    rig_destroy(&rig);
}

static void accidents_make_no_difference_to_media(void **state)
{
    (void)state;
    media_survive(false);
    media_survive(true);
}

/* A job that goes by rounds, in which one worker dies, another stops, and the master is killed; the same job
 * on this machine. */
static void rounds_make_no_difference(void **state)
{
    (void)state;
    rig_t *rig = rig_new();
    char *path = scratch_path(rig->folder, "image.exr");
    assert_int_equal(
        rig_run(rig, (const char *[]){"render", "scenes/seed-hidden", "--quiet", "-o", path, "--resolution",
                                      "128x128", "--tile-size", "16", "--adaptive", "--error", "0.05", NULL}),
        0);
    check_layers(path, true);
    hash_t reference = rig_file_hash(path);
    rig_start_master(rig, 0.2);
    pid_t workers[3];
    for (int i = 0; i < 3; i++) workers[i] = rig_start_worker(rig);
    rig_wait_workers(rig, 3);
    job_settings_t settings = rig_settings();
    settings.width = settings.height = 128;
    settings.tile_size = 16;
    settings.spp = JOB_MAX_SPP;
    settings.seed = 0;
    settings.adaptive = true;
    settings.error = 0.05;
    settings.film_scale -= 2; /* as the command does */
    uint64_t job = rig_submit(rig, &settings);
    rig_wait_samples(rig, job, 128 * 128 * 8);
    kill(workers[0], SIGKILL);
    rig_wait_samples(rig, job, 128 * 128 * 18);
    kill(workers[1], SIGSTOP);
    rig_kill_master(rig);
    rig_restart_master(rig, 0.2);
    rig_status_t status = rig_wait_job(rig, job);
    assert_int_equal(status.state, JOB_DONE);
    assert_int_equal(status.issued, status.counted + status.returned + status.out);
    assert_true(status.counted > 128 * 128 * 18);
    hash_t hash = rig_image_hash(rig, job);
    assert_true(hash_equal(&hash, &reference));
    free(path);
    rig_destroy(&rig);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(threads_and_workers_make_no_difference),
        cmocka_unit_test(photons_keep_their_bits),
        cmocka_unit_test(every_kind_of_scene_keeps_its_bits),
        cmocka_unit_test(wavelengths_keep_their_bits),
        cmocka_unit_test(layers_can_be_left_out),
        cmocka_unit_test(another_seed_gives_another_image),
        cmocka_unit_test(losing_workers_makes_no_difference),
        cmocka_unit_test(accidents_make_no_difference_to_media),
        cmocka_unit_test(rounds_make_no_difference),
    };
    return cmocka_run_group_tests_name("same bits", tests, NULL, NULL);
}
