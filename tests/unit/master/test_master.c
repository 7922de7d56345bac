/* Tests of the master as its peers see it: a real master on loopback sockets, scripted workers and clients.
 */
#include "common/image/image.h"
#include "master/farm/farm.h"
#include "master/master.h"
#include "tests/films.h"
#include "tests/peer.h"
#include "tests/scratch.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

static const double LEASE = 0.6; /* seconds; short, so that tests are */

typedef struct {
    char *folder;
    master_t *master;
    peer_t *peer;
    hash_t blob; /* of a scene that the master has */
    peer_work_t *work;
} farm_test_t;

static master_options_t options_of(const char *folder)
{
    master_options_t options = master_options_default();
    options.control_endpoint = options.bulk_endpoint = "tcp://127.0.0.1:*";
    options.data_dir = folder;
    options.heartbeat = 0.1;
    options.lease = LEASE;
    options.batch_interval = 0.5;
    return options;
}

static int set_up(void **state)
{
    farm_test_t *t = mem_zalloc(1, sizeof *t);
    log_init("test", LOG_ERROR);
    t->folder = scratch_new();
    master_options_t options = options_of(t->folder);
    result_t result = master_start(&options, &t->master);
    if (result.code != RESULT_OK) {
        fprintf(stderr, "%s\n", result.message);
        return -1;
    }
    t->peer = peer_new(master_control_port(t->master));
    uint64_t size;
    uint8_t *bytes = peer_blob(0, &size, &t->blob);
    assert_int_equal(peer_put_blob(t->peer, bytes, size, &t->blob, WIRE_MAX_CHUNK).code, RESULT_OK);
    free(bytes);
    t->work = mem_alloc(sizeof *t->work);
    *state = t;
    return 0;
}

static int tear_down(void **state)
{
    farm_test_t *t = *state;
    peer_destroy(&t->peer);
    master_stop(&t->master);
    assert_null(t->master);
    scratch_destroy(&t->folder);
    free(t->work);
    free(t);
    return 0;
}

static job_settings_t settings_of(uint32_t spp)
{
    job_settings_t settings = job_settings_default();
    settings.width = 50;
    settings.height = 40;
    settings.tile_size = 16;
    settings.spp = spp;
    return settings;
}

static uint64_t submit(farm_test_t *t, const job_settings_t *settings)
{
    uint64_t job;
    assert_int_equal(peer_submit(t->peer, "a test", settings, &t->blob, &job).code, RESULT_OK);
    return job;
}

/* Takes units and sends them back in batches until there are none. */
static void work_off(peer_t *peer, peer_work_t *work)
{
    for (peer_work(peer, 4000, 2000, work); work->job != 0; peer_work(peer, 4000, 2000, work)) {
        batch_t batch = peer_render(&work->settings, work->units, work->unit_count);
        assert_int_equal(peer_send_batch(peer, work->job, &batch).code, RESULT_OK);
        batch_free(&batch);
    }
}

/* Sends what was assigned. */
static result_t send_work(peer_t *peer, const peer_work_t *work)
{
    batch_t batch = peer_render(&work->settings, work->units, work->unit_count);
    result_t result = peer_send_batch(peer, work->job, &batch);
    batch_free(&batch);
    return result;
}

/* The image that a job of fake units must have: that of one film into which every unit went, whole tiles at
 * once. */
static hash_t expected_pixels(const char *path)
{
    image_t image;
    result_t result = image_read_exr(path, &image);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
    hash_t hash = image_hash(&image);
    image_free(&image);
    return hash;
}

/* Checks samples everywhere, and some eye values against the rule of peer_render. */
static void check_image(const char *path, const job_settings_t *settings, float samples)
{
    image_t image;
    result_t result = image_read_exr(path, &image);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
    assert_int_equal(image.width, settings->width);
    assert_int_equal(image.height, settings->height);
    const image_channel_t *channel = image_find(&image, "samples"), *eye[3];
    const image_channel_t *depth = image_find(&image, "depth.Z"), *object = image_find(&image, "object.id");
    assert_non_null(channel);
    assert_non_null(depth);
    assert_non_null(object);
    assert_true(image_find_rgb(&image, "eye", eye));
    for (int p = 0; p < image.width * image.height; p++) assert_true(channel->data[p] == samples);
    for (uint32_t tile = 0; tile < job_tile_count(settings); tile++) {
        rect_t rect = job_tile_rect(settings, tile);
        size_t half = (size_t)3 * job_tile_pixels(settings, tile);
        double sum =
            ((double)(tile * 1000) + (double)(tile * 1000 + half)) * (1 << 20); /* both halves, x = y = 0 */
        double value = ldexp(sum, -settings->film_scale); /* the rule is linear in the samples */
        float got = eye[0]->data[(size_t)(rect.y0 * image.width + rect.x0) * eye[0]->stride];
        assert_true(fabs((double)got - value) <= 1e-6 * value);
        size_t last = (size_t)((rect.y1 - 1) * image.width + rect.x1 - 1);
        assert_true(depth->data[last] == (float)tile + 0.5f && object->data[last] == (float)tile + 1.0f);
    }
    image_free(&image);
}

/* ---- tests --------------------------------------------------------------------------------------------- */

static void a_job_goes_through(void **state)
{
    farm_test_t *t = *state;
    job_settings_t settings = settings_of(8);
    wire_message_t message;
    peer_hello(t->peer, WIRE_VERSION, 2, NULL);
    peer_work(t->peer, 1000, 1000, t->work);
    assert_int_equal(t->work->job, 0); /* nothing to do yet */
    uint64_t job = submit(t, &settings);
    if (t->peer->job_ready == 0) peer_listen(t->peer, 2); /* else it came before the job's number */
    assert_int_equal(t->peer->job_ready, 1);
    const Lm__JobStatus *status = peer_status(t->peer, job, &message);
    assert_int_equal(status->state, JOB_QUEUED);
    assert_int_equal(status->samples_total, 50 * 40 * 8);
    wire_free(&message);
    work_off(t->peer, t->work);
    assert_int_equal(peer_wait(t->peer, job, 5), JOB_DONE);
    assert_int_equal(t->peer->job_over, 1);
    assert_true(t->peer->over_job == job);
    status = peer_status(t->peer, job, &message);
    assert_true(status->samples_done == status->samples_total);
    assert_true(status->batches > 1 && status->batches_refused == 0);
    assert_true(status->bytes_received > 1000);
    assert_int_equal(status->workers_seen, 1);
    assert_int_equal(status->workers, 0);
    assert_true(status->counts->light_paths_even == 50 * 40 * 4);
    wire_free(&message);

    char *name = mem_printf("%s/job-%llu.exr", t->folder, (unsigned long long)job),
         *path = scratch_path(t->folder, "f.exr");
    check_image(name, &settings, 8);
    assert_int_equal(peer_fetch(t->peer, job, false, 1000, path).code, RESULT_OK);
    hash_t stored = expected_pixels(name), fetched = expected_pixels(path);
    assert_true(hash_equal(&stored, &fetched));
    result_t result = peer_fetch(t->peer, job, true, WIRE_MAX_CHUNK, path);
    if (result.code != RESULT_OK) fail_msg("%s", result.message);
    image_t image;
    assert_int_equal(image_read_exr(path, &image).code, RESULT_OK);
    assert_int_equal(image_find(&image, "R")->type, PIXEL_HALF);
    image_free(&image);
    free(name);
    free(path);
    peer_goodbye(t->peer);
    assert_false(peer_heartbeat(t->peer, 0, 0));
}

static void another_version_is_refused(void **state)
{
    farm_test_t *t = *state;
    result_t refused;
    peer_hello(t->peer, WIRE_VERSION + 1, 2, &refused);
    assert_int_equal(refused.code, RESULT_PROTOCOL);
    assert_non_null(strstr(refused.message, "version"));
    peer_hello(t->peer, WIRE_VERSION, 2, &refused);
    assert_int_equal(refused.code, RESULT_OK);
}

static void who_does_not_reach_the_bulk_socket_gets_no_work(void **state)
{
    farm_test_t *t = *state;
    job_settings_t settings = settings_of(4);
    t->peer->unprobed = true;
    peer_hello(t->peer, WIRE_VERSION, 2, NULL);
    uint64_t job = submit(t, &settings);
    peer_work(t->peer, 1000, 1000, t->work);
    assert_int_equal(t->work->job, 0);
    assert_int_equal(peer_probe(t->peer, WIRE_MAX_PROBE + 1).code, RESULT_PROTOCOL);
    peer_work(t->peer, 1000, 1000, t->work);
    assert_int_equal(t->work->job, 0);
    assert_int_equal(peer_probe(t->peer, WIRE_MAX_PROBE).code, RESULT_OK);
    peer_work(t->peer, 1000, 1000, t->work);
    assert_true(t->work->job == job);
    t->peer->worker++;
    assert_int_equal(peer_probe(t->peer, 0).code, RESULT_UNREACHABLE);
}

static void unknown_scenes_jobs_and_workers_are_refused(void **state)
{
    farm_test_t *t = *state;
    job_settings_t settings = settings_of(4);
    hash_t unknown = hash_bytes("?", 1);
    uint64_t job;
    wire_message_t message;
    assert_int_equal(peer_submit(t->peer, "x", &settings, &unknown, &job).code, RESULT_INPUT);
    settings.width = 0;
    assert_int_not_equal(peer_submit(t->peer, "x", &settings, &t->blob, &job).code, RESULT_OK);
    settings.width = JOB_MAX_RESOLUTION;
    settings.height = JOB_MAX_RESOLUTION;
    assert_int_not_equal(peer_submit(t->peer, "x", &settings, &t->blob, &job).code, RESULT_OK);
    assert_int_equal(peer_cancel(t->peer, 77).code, RESULT_INPUT);
    assert_null(peer_status(t->peer, 77, &message));
    t->peer->worker = 12345;
    assert_false(peer_heartbeat(t->peer, 0, 0));
    peer_work(t->peer, 1000, 1000, t->work);
    assert_int_equal(t->work->refused.code, RESULT_UNREACHABLE);
    settings = settings_of(4);
    job = submit(t, &settings);
    const unit_t unit = {0, 0, 1};
    batch_t batch = peer_render(&settings, &unit, 1);
    assert_int_equal(peer_send_batch(t->peer, job, &batch).code, RESULT_MISMATCH);
    batch_free(&batch);
    char *path = scratch_path(t->folder, "f.exr");
    assert_int_equal(peer_fetch(t->peer, job, false, 1000, path).code, RESULT_INPUT); /* no samples yet */
    assert_int_equal(peer_fetch(t->peer, 77, false, 1000, path).code, RESULT_INPUT);
    free(path);
}

static void batches_count_once(void **state)
{
    farm_test_t *t = *state;
    job_settings_t settings = settings_of(4);
    uint64_t job = submit(t, &settings);
    wire_message_t message;
    peer_hello(t->peer, WIRE_VERSION, 1, NULL);
    peer_work(t->peer, 3000, 500, t->work);
    assert_true(t->work->unit_count >= 2);
    batch_t first = peer_render(&settings, t->work->units, 1);
    batch_t all = peer_render(&settings, t->work->units, t->work->unit_count);
    assert_int_equal(peer_send_batch(t->peer, job, &first).code, RESULT_OK);
    assert_int_equal(peer_send_batch(t->peer, job, &first).code, RESULT_MISMATCH); /* a duplicate */
    assert_int_equal(peer_send_batch(t->peer, job, &all).code, RESULT_MISMATCH);   /* one unit of it is */
    const Lm__JobStatus *status = peer_status(t->peer, job, &message);
    assert_int_equal(status->batches, 1);
    assert_int_equal(status->batches_refused, 2);
    assert_int_equal(status->units_reissued, t->work->unit_count - 1);
    assert_int_equal(status->workers, 0); /* all was taken back */
    wire_free(&message);
    batch_free(&first);
    batch_free(&all);
    work_off(t->peer, t->work);
    assert_int_equal(peer_wait(t->peer, job, 5), JOB_DONE);
    char *name = mem_printf("%s/job-%llu.exr", t->folder, (unsigned long long)job);
    check_image(name, &settings, 4);
    free(name);
    const unit_t unit = {0, 0, 1};
    batch_t late = peer_render(&settings, &unit, 1);
    assert_int_equal(peer_send_batch(t->peer, job, &late).code, RESULT_MISMATCH); /* the job is over */
    batch_free(&late);
}

static void silent_workers_lose_their_units(void **state)
{
    farm_test_t *t = *state;
    job_settings_t settings = settings_of(4);
    uint64_t job = submit(t, &settings);
    peer_t *silent = peer_new(master_control_port(t->master)),
           *late = peer_new(master_control_port(t->master));
    peer_work_t *lost = mem_alloc(sizeof *lost), *kept = mem_alloc(sizeof *kept);
    wire_message_t message;
    peer_hello(silent, WIRE_VERSION, 1, NULL);
    peer_hello(late, WIRE_VERSION, 1, NULL);
    peer_work(silent, 3000, 500, lost);
    peer_work(late, 3000, 500, kept);
    peer_hello(t->peer, WIRE_VERSION, 1, NULL);
    double start = clock_now();
    uint32_t holders = 2;
    while (holders > 0 && clock_now() - start < 10) { /* only this peer is heard of */
        assert_true(peer_heartbeat(t->peer, 0, 0));
        holders = peer_status(t->peer, job, &message)->workers;
        wire_free(&message);
        usleep(30000);
    }
    assert_true(clock_now() - start < LEASE + 1.5);
    assert_true(clock_now() - start > LEASE / 2);
    assert_false(peer_heartbeat(silent, job, 3));
    /* A straggler whose units nobody delivered yet is welcome, once. */
    assert_int_equal(send_work(late, kept).code, RESULT_OK);
    assert_int_equal(send_work(late, kept).code, RESULT_MISMATCH);
    work_off(t->peer, t->work);
    assert_int_equal(send_work(silent, lost).code, RESULT_MISMATCH); /* too late */
    assert_int_equal(peer_wait(t->peer, job, 5), JOB_DONE);
    const Lm__JobStatus *status = peer_status(t->peer, job, &message);
    assert_int_equal(status->units_reissued, lost->unit_count + kept->unit_count);
    assert_int_equal(status->workers_seen, 2);
    wire_free(&message);
    char *name = mem_printf("%s/job-%llu.exr", t->folder, (unsigned long long)job);
    check_image(name, &settings, 4);
    free(name);
    free(lost);
    free(kept);
    peer_destroy(&silent);
    peer_destroy(&late);
}

static void a_goodbye_gives_units_back_at_once(void **state)
{
    farm_test_t *t = *state;
    job_settings_t settings = settings_of(1);
    submit(t, &settings);
    peer_t *leaver = peer_new(master_control_port(t->master));
    peer_hello(leaver, WIRE_VERSION, 1, NULL);
    peer_hello(t->peer, WIRE_VERSION, 1, NULL);
    for (peer_work(leaver, 1 << 20, 1 << 20, t->work); t->work->job != 0;)
        peer_work(leaver, 1 << 20, 1 << 20, t->work);
    peer_work(t->peer, 1000, 1000, t->work);
    assert_int_equal(t->work->job, 0); /* the other one has it all */
    peer_goodbye(leaver);
    peer_listen(t->peer, 2);
    assert_int_equal(t->peer->job_ready, 1);
    peer_work(t->peer, 1000, 1000, t->work);
    assert_true(t->work->job != 0);
    peer_destroy(&leaver);
}

static void jobs_go_side_by_side(void **state)
{
    farm_test_t *t = *state;
    job_settings_t settings = settings_of(2);
    uint64_t first = submit(t, &settings), second = submit(t, &settings);
    wire_message_t message;
    peer_t *holder = peer_new(master_control_port(t->master));
    peer_work_t *held = mem_alloc(sizeof *held);
    peer_hello(holder, WIRE_VERSION, 1, NULL);
    peer_hello(t->peer, WIRE_VERSION, 1, NULL);
    peer_work(holder, 500, 500, held);
    assert_true(held->job == first);
    bool second_begun = false;
    for (peer_work(t->peer, 4000, 2000, t->work); t->work->job != 0;
         peer_work(t->peer, 4000, 2000, t->work)) {
        second_begun |= t->work->job == second;
        assert_int_equal(send_work(t->peer, t->work).code, RESULT_OK);
    }
    /* The second was begun while the first waited for the other worker's units. */
    assert_true(second_begun);
    assert_int_equal(peer_status(t->peer, first, &message)->state, JOB_RUNNING);
    wire_free(&message);
    assert_int_equal(send_work(holder, held).code, RESULT_OK);
    assert_int_equal(peer_wait(t->peer, first, 5), JOB_DONE);
    assert_int_equal(peer_wait(t->peer, second, 5), JOB_DONE);
    char *a = mem_printf("%s/job-%llu.exr", t->folder, (unsigned long long)first);
    char *b = mem_printf("%s/job-%llu.exr", t->folder, (unsigned long long)second);
    hash_t hash_a = expected_pixels(a), hash_b = expected_pixels(b);
    assert_true(hash_equal(&hash_a, &hash_b)); /* whoever did it */
    free(a);
    free(b);
    free(held);
    peer_destroy(&holder);
}

static void a_cancelled_job_keeps_what_workers_have(void **state)
{
    farm_test_t *t = *state;
    job_settings_t settings = settings_of(64);
    uint64_t waiting, job = submit(t, &settings);
    wire_message_t message;
    waiting = submit(t, &settings);
    peer_hello(t->peer, WIRE_VERSION, 1, NULL);
    peer_work(t->peer, 3000, 1000, t->work);
    assert_int_equal(peer_cancel(t->peer, waiting).code, RESULT_OK);
    assert_int_equal(peer_wait(t->peer, waiting, 1), JOB_CANCELLED);
    assert_int_equal(peer_cancel(t->peer, waiting).code, RESULT_INPUT);
    assert_int_equal(peer_cancel(t->peer, job).code, RESULT_OK);
    assert_int_equal(peer_status(t->peer, job, &message)->state, JOB_FINISHING);
    wire_free(&message);
    if (t->peer->flush == 0) peer_listen(t->peer, 2);
    assert_int_equal(t->peer->flush, 1);
    assert_int_equal(send_work(t->peer, t->work).code, RESULT_OK);
    assert_int_equal(peer_wait(t->peer, job, 5), JOB_CANCELLED);
    const Lm__JobStatus *status = peer_status(t->peer, job, &message);
    assert_true(status->samples_done > 0 && status->samples_done < status->samples_total);
    wire_free(&message);
    char *path = scratch_path(t->folder, "f.exr");
    assert_int_equal(peer_fetch(t->peer, job, false, 100000, path).code, RESULT_OK);
    free(path);
    peer_work(t->peer, 3000, 1000, t->work);
    assert_int_equal(t->work->job, 0);
}

static void a_cancelled_job_does_not_wait_for_ever(void **state)
{
    farm_test_t *t = *state;
    job_settings_t settings = settings_of(64);
    uint64_t job = submit(t, &settings);
    peer_hello(t->peer, WIRE_VERSION, 1, NULL);
    peer_work(t->peer, 3000, 1000, t->work);
    assert_int_equal(peer_cancel(t->peer, job).code, RESULT_OK);
    double until = clock_now() + 5;
    wire_message_t message;
    uint32_t job_state = 0;
    while (job_state != JOB_CANCELLED && clock_now() < until) { /* alive, but it never answers the flush */
        assert_true(peer_heartbeat(t->peer, job, 3));
        job_state = peer_status(t->peer, job, &message)->state;
        wire_free(&message);
        usleep(20000);
    }
    assert_int_equal(job_state, JOB_CANCELLED);
}

static void time_ends_a_job(void **state)
{
    farm_test_t *t = *state;
    job_settings_t settings = settings_of(JOB_MAX_SPP);
    settings.time_limit = 0.5;
    uint64_t job = submit(t, &settings);
    wire_message_t message;
    peer_hello(t->peer, WIRE_VERSION, 1, NULL);
    double start = clock_now();
    work_off(t->peer, t->work); /* ends when the master hands out no more */
    assert_true(clock_now() - start > 0.4 && clock_now() - start < 3);
    assert_int_equal(peer_wait(t->peer, job, 5), JOB_DONE);
    const Lm__JobStatus *status = peer_status(t->peer, job, &message);
    assert_true(status->samples_total == 0 && status->samples_done > 50 * 40);
    wire_free(&message);
}

/* Takes what is left of the work once, and delivers it with a value more at one place. */
static result_t deliver_with(farm_test_t *t, peer_t *peer, const job_settings_t *settings, int64_t more)
{
    peer_work(peer, 500, 500, t->work);
    assert_int_not_equal(t->work->job, 0);
    batch_t batch = peer_render(settings, t->work->units, t->work->unit_count);
    batch.sums[SUM_EYE].values[5] += more;
    result_t result = peer_send_check(peer, t->work->job, t->work->check, &batch);
    batch_free(&batch);
    return result;
}

static void overflow_fails_the_job_the_second_time(void **state)
{
    farm_test_t *t = *state;
    job_settings_t settings = settings_of(1);
    uint64_t job = submit(t, &settings);
    wire_message_t message;
    peer_hello(t->peer, WIRE_VERSION, 1, NULL);
    assert_int_equal(deliver_with(t, t->peer, &settings, INT64_C(1) << 62).code, RESULT_MISMATCH);
    assert_int_equal(t->work->check, 0);
    assert_int_equal(deliver_with(t, t->peer, &settings, INT64_C(1) << 62).code, RESULT_OK);
    assert_int_not_equal(t->work->check, 0);
    assert_int_equal(peer_wait(t->peer, job, 5), JOB_FAILED);
    assert_non_null(strstr(peer_status(t->peer, job, &message)->message, "--film-scale 24"));
    wire_free(&message);
}

/* As above, but another worker does not agree: its sums count. */
static void sums_that_are_too_large_are_rendered_by_another(void **state)
{
    farm_test_t *t = *state;
    job_settings_t settings = settings_of(1);
    uint64_t job = submit(t, &settings);
    peer_t *other = peer_new(master_control_port(t->master));
    peer_hello(t->peer, WIRE_VERSION, 1, NULL);
    other->name = "other";
    peer_hello(other, WIRE_VERSION, 1, NULL);
    assert_int_equal(deliver_with(t, t->peer, &settings, (int64_t)411552 << 32).code, RESULT_MISMATCH);
    assert_int_equal(deliver_with(t, other, &settings, 0).code, RESULT_OK);
    assert_int_not_equal(t->work->check, 0);
    work_off(other, t->work);
    assert_int_equal(peer_wait(t->peer, job, 5), JOB_DONE);
    peer_destroy(&other);
}

static void impossible_batches_are_refused(void **state)
{
    farm_test_t *t = *state;
    job_settings_t settings = settings_of(16);
    uint64_t job = submit(t, &settings);
    peer_hello(t->peer, WIRE_VERSION, 8, NULL);
    peer_work(t->peer, 3000, 500, t->work);
    batch_t batch = peer_render(&settings, t->work->units, t->work->unit_count);
    unit_t good = batch.units[0];
    const unit_t bad[] = {{1 << 20, 0, 1}, {0, 16, 1}, {0, 0, 17}, {0, UINT32_MAX, 1}, {0, 0, 0}};
    for (size_t i = 0; i < ARRAY_LENGTH(bad); i++) {
        batch.units[0] = bad[i];
        assert_int_equal(peer_send_batch(t->peer, job, &batch).code, RESULT_MISMATCH);
        /* That is held against it, until it delivers. */
        batch_t last = peer_render(&settings, &t->work->units[--t->work->unit_count], 1);
        assert_int_equal(peer_send_batch(t->peer, job, &last).code, RESULT_OK);
        batch_free(&last);
    }
    batch.units[0] = batch.units[1]; /* twice the same */
    assert_int_equal(peer_send_batch(t->peer, job, &batch).code, RESULT_MISMATCH);
    batch.units[0] = good;
    batch.counts.light_paths[0]--; /* the splats would be brighter */
    assert_int_equal(peer_send_batch(t->peer, job, &batch).code, RESULT_MISMATCH);
    batch.counts.light_paths[0]++;
    batch.counts.rays = UINT64_MAX;
    assert_int_equal(peer_send_batch(t->peer, job, &batch).code, RESULT_MISMATCH);
    batch.counts.rays = 0;
    assert_int_equal(peer_send_batch(t->peer, job + 1, &batch).code, RESULT_MISMATCH);
    /* Units of the refused batches went back, and are given out again. */
    peer_work(t->peer, 3000, 500, t->work);
    assert_int_equal(send_work(t->peer, t->work).code, RESULT_OK);
    batch_free(&batch);
}

static void uploads_are_resumed_and_verified(void **state)
{
    farm_test_t *t = *state;
    hash_t hash, wrong;
    uint64_t size, next;
    uint8_t *bytes = peer_blob(5, &size, &hash);
    assert_int_equal(peer_put_chunk(t->peer, &hash, 0, size, NULL, 0, &next).code, RESULT_OK);
    assert_int_equal(next, 0);
    assert_int_equal(peer_put_chunk(t->peer, &hash, 0, size, bytes, 100, &next).code, RESULT_OK);
    assert_int_equal(next, 100);
    /* Another client, or the same one after a broken link, asks where to go on; what does not fit is not
     * taken. */
    peer_t *other = peer_new(master_control_port(t->master));
    assert_int_equal(peer_put_chunk(other, &hash, 0, size, NULL, 0, &next).code, RESULT_OK);
    assert_int_equal(next, 100);
    assert_int_equal(peer_put_chunk(other, &hash, 300, size, bytes + 300, 10, &next).code, RESULT_OK);
    assert_int_equal(next, 100);
    uint8_t *large = mem_zalloc(1, WIRE_MAX_CHUNK + 1);
    assert_int_not_equal(peer_put_chunk(other, &hash, 100, size, large, WIRE_MAX_CHUNK + 1, &next).code,
                         RESULT_OK);
    free(large);
    assert_int_equal(peer_put_blob(other, bytes, size, &hash, 77).code, RESULT_OK);
    assert_int_equal(peer_put_chunk(other, &hash, 0, size, NULL, 0, &next).code, RESULT_OK);
    assert_int_equal(next, size);
    peer_destroy(&other);
    /* Right bytes under a wrong name, then bytes that are no blob under their right name. */
    wrong = hash_bytes("something else", 14);
    assert_int_equal(peer_put_blob(t->peer, bytes, size, &wrong, 1000).code, RESULT_INPUT);
    bytes[200] ^= 1;
    wrong = hash_bytes(bytes, size);
    assert_int_equal(peer_put_blob(t->peer, bytes, size, &wrong, 1000).code, RESULT_INPUT);
    assert_int_equal(peer_put_chunk(t->peer, &wrong, 0, size, NULL, 0, &next).code, RESULT_OK);
    assert_int_equal(next, 0); /* nothing of it was kept */
    job_settings_t settings = settings_of(1);
    uint64_t job;
    assert_int_equal(peer_submit(t->peer, "x", &settings, &wrong, &job).code, RESULT_INPUT);
    assert_int_equal(peer_put_chunk(t->peer, &wrong, 0, UINT64_MAX, bytes, 10, &next).code, RESULT_LIMIT);
    free(bytes);
}

static void blobs_are_fetched_in_chunks(void **state)
{
    farm_test_t *t = *state;
    hash_t hash;
    uint64_t size, offset = 0;
    uint8_t *bytes = peer_blob(0, &size, &hash), *got = mem_alloc(size);
    while (offset < size) {
        Lm__BlobGet get = LM__BLOB_GET__INIT;
        Lm__Envelope envelope = LM__ENVELOPE__INIT;
        get.blob = wire_hash_put(&hash);
        get.offset = offset;
        get.length = 333;
        envelope.body_case = LM__ENVELOPE__BODY_BLOB_GET;
        envelope.blob_get = &get;
        wire_message_t answer = peer_ask_bulk(t->peer, &envelope, NULL, 0);
        assert_int_equal(answer.envelope->body_case, LM__ENVELOPE__BODY_BLOB_CHUNK);
        assert_true(answer.envelope->blob_chunk->size == size);
        size_t length = zmq_msg_size(&answer.payload[0]);
        assert_true(length > 0 && length <= 333 && offset + length <= size);
        memcpy(got + offset, zmq_msg_data(&answer.payload[0]), length);
        offset += length;
        wire_free(&answer);
    }
    assert_memory_equal(got, bytes, size);
    free(got);
    free(bytes);
}

static void images_are_there_at_any_time(void **state)
{
    farm_test_t *t = *state;
    job_settings_t settings = settings_of(64);
    uint64_t job = submit(t, &settings);
    char *path = scratch_path(t->folder, "f.exr"), *snapshots = scratch_path(t->folder, "snapshots");
    peer_hello(t->peer, WIRE_VERSION, 1, NULL);
    for (int i = 0; i < 40; i++) {
        peer_work(t->peer, 500, 500, t->work);
        assert_int_equal(send_work(t->peer, t->work).code, RESULT_OK);
        assert_int_equal(peer_fetch(t->peer, job, i % 2 == 1, 1 << 20, path).code, RESULT_OK);
        hash_t first = expected_pixels(path);
        assert_int_equal(peer_fetch(t->peer, job, i % 2 == 1, 1 << 20, path).code, RESULT_OK);
        hash_t again = expected_pixels(path);
        assert_true(hash_equal(&first, &again));
    }
    assert_true(scratch_count(snapshots) <= 16);
    free(path);
    free(snapshots);
}

/* Random, truncated and misplaced messages on both sockets, while a job goes on. */
static void hostile_bytes_do_no_harm(void **state)
{
    farm_test_t *t = *state;
    job_settings_t settings = settings_of(8);
    uint64_t job = submit(t, &settings), random = 3;
    void *raw[2] = {peer_raw_socket(t->peer, false), peer_raw_socket(t->peer, true)};
    peer_hello(t->peer, WIRE_VERSION, 1, NULL);
    uint8_t bytes[200];
    for (int i = 0; i < 400; i++) {
        size_t size = 0;
        for (; size < sizeof bytes; size++) {
            random = random * 6364136223846793005u + 1442695040888963407u;
            bytes[size] = (uint8_t)(random >> 33);
        }
        size = (random >> 40) % sizeof bytes;
        if (i % 3 > 0) memcpy(bytes, "LMIL\7", 5);
        if (i % 3 > 1)
            bytes[PEER_ENVELOPE_AT] = (uint8_t)(8 * (2 + random % 25) + 2),
            bytes[PEER_ENVELOPE_AT + 1] = (uint8_t)(random >> 50) % 64;
        if (i % 6 > 0) peer_seal(bytes, size, NULL, NULL, 0);
        int more = i % 7 == 0 ? ZMQ_SNDMORE : 0;
        for (int s = 0; s < 2; s++) {
            assert_int_equal(zmq_send(raw[s], bytes, size, more), (int)size);
            for (int extra = more ? i % 4 : 0; more && extra >= 0; extra--)
                assert_true(zmq_send(raw[s], bytes, size, extra > 0 ? ZMQ_SNDMORE : 0) >= 0);
        }
        if (i % 10 == 0) {
            peer_work(t->peer, 300, 300, t->work);
            if (t->work->job != 0) assert_int_equal(send_work(t->peer, t->work).code, RESULT_OK);
        }
    }
    /* A truncated copy of a good batch, as its sender would never send it. */
    work_off(t->peer, t->work);
    assert_int_equal(peer_wait(t->peer, job, 5), JOB_DONE);
    char *name = mem_printf("%s/job-%llu.exr", t->folder, (unsigned long long)job);
    check_image(name, &settings, 8);
    free(name);
    for (int s = 0; s < 2; s++) zmq_close(raw[s]);
}

/* Sends the first payloads of a batch, cut short somewhere. */
static void send_damaged(peer_t *peer, uint64_t job, const batch_t *batch, int number, uint64_t *random)
{
    Lm__BatchResult body = LM__BATCH_RESULT__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    zmq_msg_t good[BATCH_PAYLOADS], cut[BATCH_PAYLOADS];
    body.worker = peer->worker;
    body.job = job;
    body.n_units = batch->unit_count;
    issue_t *issues = peer_issues(peer, batch->units, batch->unit_count);
    body.units = wire_units_new(batch->units, issues, batch->unit_count);
    free(issues);
    envelope.body_case = LM__ENVELOPE__BODY_BATCH_RESULT;
    envelope.batch_result = &body;
    assert_int_equal(encode_either(batch, number % 2, good).code, RESULT_OK);
    for (int p = 0; p < BATCH_PAYLOADS; p++) {
        *random = *random * 6364136223846793005u + 1442695040888963407u;
        size_t size = zmq_msg_size(&good[p]);
        if (size > 0) size = (*random >> 33) % size;
        zmq_msg_init_size(&cut[p], size);
        memcpy(zmq_msg_data(&cut[p]), zmq_msg_data(&good[p]), size);
        zmq_msg_close(&good[p]);
    }
    int sent = number % 4 == 3 ? BATCH_PAYLOADS : 1 + number % BATCH_PAYLOADS;
    wire_message_t answer = peer_ask_bulk(peer, &envelope, cut, sent);
    assert_int_equal(answer.envelope->body_case, LM__ENVELOPE__BODY_BATCH_REPLY);
    assert_false(answer.envelope->batch_reply->accepted);
    wire_free(&answer);
    for (int p = sent; p < BATCH_PAYLOADS; p++) zmq_msg_close(&cut[p]);
    free(body.units);
}

/* What is refused is not counted; who sends nothing else is put aside. */
static void damaged_payloads_are_refused(void **state)
{
    farm_test_t *t = *state;
    job_settings_t settings = settings_of(128);
    uint64_t job = submit(t, &settings), random = 5;
    result_t refused;
    peer_hello(t->peer, WIRE_VERSION, 1, NULL);
    for (int i = 0; i < 50; i++) {
        peer_work(t->peer, 3000, 500, t->work);
        assert_true(t->work->job == job);
        batch_t batch = peer_render(&settings, t->work->units, t->work->unit_count);
        for (int n = 0; n < FARM_MAX_FAILURES - 1; n++) send_damaged(t->peer, job, &batch, i + n, &random);
        if (i < 49) assert_int_equal(peer_send_batch(t->peer, job, &batch).code, RESULT_OK);
        for (int n = 0; n < FARM_MAX_FAILURES && i == 49; n++) send_damaged(t->peer, job, &batch, 3, &random);
        batch_free(&batch);
    }
    peer_hello(t->peer, WIRE_VERSION, 1, &refused);
    assert_int_equal(refused.code, RESULT_CANCELLED);
    assert_non_null(strstr(refused.message, "malformed"));
}

static void a_job_goes_on_after_a_stop(void **state)
{
    farm_test_t *t = *state;
    job_settings_t settings = settings_of(16);
    uint64_t job = submit(t, &settings);
    wire_message_t message;
    peer_hello(t->peer, WIRE_VERSION, 1, NULL);
    peer_work(t->peer, 3000, 1000, t->work);
    assert_int_equal(send_work(t->peer, t->work).code, RESULT_OK);
    uint64_t done = peer_status(t->peer, job, &message)->samples_done;
    wire_free(&message);
    assert_true(done > 0);
    master_stop(&t->master);
    /* A new master on the same data has it all, and does not reuse the number. */
    master_options_t options = options_of(t->folder);
    assert_int_equal(master_start(&options, &t->master).code, RESULT_OK);
    peer_destroy(&t->peer);
    t->peer = peer_new(master_control_port(t->master));
    assert_true(peer_status(t->peer, job, &message)->samples_done == done);
    wire_free(&message);
    for (double until = clock_now() + 5; clock_now() < until; usleep(20000)) {
        bool running = peer_status(t->peer, job, &message)->state == JOB_RUNNING;
        wire_free(&message);
        if (running) break;
    }
    peer_hello(t->peer, WIRE_VERSION, 1, NULL);
    work_off(t->peer, t->work);
    assert_int_equal(peer_wait(t->peer, job, 5), JOB_DONE);
    char *name = mem_printf("%s/job-%llu.exr", t->folder, (unsigned long long)job);
    check_image(name, &settings, 16);
    free(name);
    assert_true(submit(t, &settings) > job);
}

static void bad_options_are_errors_with_a_cure(void **state)
{
    farm_test_t *t = *state;
    master_t *master;
    char *other = scratch_path(t->folder, "other");
    master_options_t options = options_of(t->folder);
    result_t result = master_start(&options, &master); /* the folder is taken */
    assert_int_equal(result.code, RESULT_IO);
    assert_non_null(strstr(result.message, "another master"));
    assert_null(master);
    options = options_of(other);
    options.control_endpoint = "ipc://somewhere";
    assert_int_equal(master_start(&options, &master).code, RESULT_USAGE);
    options.control_endpoint = "tcp://0.0.0.0:*";
    options.gate.insecure = true;
    options.gate.key = "none.secret";
    assert_int_equal(master_start(&options, &master).code, RESULT_USAGE);
    options.gate.key = NULL;
    assert_int_equal(master_start(&options, &master).code, RESULT_OK);
    master_stop(&master);
    options = options_of(other);
    options.lease = 0.15;
    assert_int_equal(master_start(&options, &master).code, RESULT_USAGE);
    options.lease = NAN;
    assert_int_equal(master_start(&options, &master).code, RESULT_USAGE);
    char *port = mem_printf("tcp://127.0.0.1:%d", master_control_port(t->master));
    options = options_of(other);
    options.control_endpoint = port;
    result = master_start(&options, &master);
    assert_int_equal(result.code, RESULT_IO);
    assert_non_null(strstr(result.message, "--listen"));
    free(port);
    options = options_of("/proc/nowhere/data");
    assert_int_equal(master_start(&options, &master).code, RESULT_IO);
    free(other);
}

static void it_runs_over_inproc(void **state)
{
    farm_test_t *t = *state;
    void *context = zmq_ctx_new(), *socket;
    char *other = scratch_path(t->folder, "other");
    master_options_t options = options_of(other);
    master_t *master;
    options.context = context;
    options.control_endpoint = "inproc://control";
    options.bulk_endpoint = "inproc://bulk";
    assert_int_equal(master_start(&options, &master).code, RESULT_OK);
    assert_int_equal(master_control_port(master), 0);
    assert_int_equal(wire_socket(context, ZMQ_DEALER, &socket).code, RESULT_OK);
    assert_int_equal(zmq_connect(socket, "inproc://control"), 0);
    Lm__Hello hello = LM__HELLO__INIT;
    Lm__Envelope envelope = LM__ENVELOPE__INIT;
    hello.protocol_version = WIRE_VERSION;
    envelope.body_case = LM__ENVELOPE__BODY_HELLO;
    envelope.hello = &hello;
    wire_message_t message;
    bool received;
    assert_int_equal(wire_send(socket, NULL, 0, &envelope, NULL, 0).code, RESULT_OK);
    zmq_pollitem_t item = {.socket = socket, .events = ZMQ_POLLIN};
    zmq_poll(&item, 1, 5000);
    assert_int_equal(wire_receive(socket, false, &message, &received).code, RESULT_OK);
    assert_true(received);
    assert_int_equal(message.envelope->body_case, LM__ENVELOPE__BODY_WELCOME);
    assert_int_equal(message.envelope->welcome->bulk_port, 0);
    wire_free(&message);
    zmq_close(socket);
    master_stop(&master);
    zmq_ctx_term(context);
    free(other);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
#define WITH_MASTER(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)
        WITH_MASTER(a_job_goes_through),
        WITH_MASTER(another_version_is_refused),
        WITH_MASTER(who_does_not_reach_the_bulk_socket_gets_no_work),
        WITH_MASTER(unknown_scenes_jobs_and_workers_are_refused),
        WITH_MASTER(batches_count_once),
        WITH_MASTER(silent_workers_lose_their_units),
        WITH_MASTER(a_goodbye_gives_units_back_at_once),
        WITH_MASTER(jobs_go_side_by_side),
        WITH_MASTER(a_cancelled_job_keeps_what_workers_have),
        WITH_MASTER(a_cancelled_job_does_not_wait_for_ever),
        WITH_MASTER(time_ends_a_job),
        WITH_MASTER(overflow_fails_the_job_the_second_time),
        WITH_MASTER(sums_that_are_too_large_are_rendered_by_another),
        WITH_MASTER(impossible_batches_are_refused),
        WITH_MASTER(uploads_are_resumed_and_verified),
        WITH_MASTER(blobs_are_fetched_in_chunks),
        WITH_MASTER(images_are_there_at_any_time),
        WITH_MASTER(hostile_bytes_do_no_harm),
        WITH_MASTER(damaged_payloads_are_refused),
        WITH_MASTER(a_job_goes_on_after_a_stop),
        WITH_MASTER(bad_options_are_errors_with_a_cure),
        WITH_MASTER(it_runs_over_inproc),
    };
    return cmocka_run_group_tests_name("master", tests, NULL, NULL);
}
